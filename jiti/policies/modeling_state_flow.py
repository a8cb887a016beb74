"""The flow-matching policy from state as a LeRobot policy: learns a velocity, draws chunks from noise."""

from collections import deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch  # noqa: TID253 - lerobot's plugin, imported with the policy
from lerobot.policies.pretrained import PreTrainedPolicy  # noqa: TID253
from torch import Tensor  # noqa: TID253

from jiti.errors import UsageError
from jiti.policies.configuration_state_flow import StateFlowConfig
from jiti.policies.flow_network import FlowNetwork, flow_loss, follow, integrate, interpolate, ramped
from jiti.policies.levels import Levels

ACTION = "action"
PADDING = "action_is_pad"


class StateFlowPolicy(PreTrainedPolicy):
    """Trained on batches, acts by an average of its weights. lerobot finds this class by its name.

    The config's instructions are the dataset's where none are given; they are saved with it, so that a rollout gives
    the instruction as text (`task`). Noise that is passed makes chunks reproducible.
    """

    config_class = StateFlowConfig  # pyright: ignore[reportAssignmentType] - lerobot declares it None
    name = "state_flow"  # pyright: ignore[reportAssignmentType]

    def __init__(
        self,
        config: StateFlowConfig,
        *,
        dataset_stats: Mapping[str, Mapping[str, Any]] | None = None,
        dataset_meta: Any = None,
        **_unused: Any,
    ) -> None:
        """`dataset_stats` and `dataset_meta` come from lerobot when a policy is made for training."""
        super().__init__(config)
        config.validate_features()
        self.config: StateFlowConfig = config
        if not config.instructions and dataset_meta is not None:
            config.instructions = [str(task) for task in dataset_meta.tasks.index]
        if not config.instructions:
            config.instructions = [""]
        assert config.action_feature is not None
        actions = config.action_feature.shape[0]
        self.network = FlowNetwork(
            sum(config.observed().values()),
            len(config.instructions),
            config.chunk_size,
            actions,
            width=config.width,
            depth=config.depth,
            frequencies=config.frequencies,
        )
        self.average = deepcopy(self.network).requires_grad_(False)
        self.levels = Levels(actions)
        if dataset_stats is not None and ACTION in dataset_stats:
            self.levels.learn(dataset_stats[ACTION])
        self.register_buffer("updates", torch.zeros((), dtype=torch.int64))
        self.reset()

    def get_optim_params(self) -> Any:
        """The network's; the average follows it."""
        return self.network.parameters()

    def reset(self) -> None:
        """Forget what is left of a chunk. To be called when an episode begins."""
        self._left: deque[Tensor] = deque(maxlen=self.config.n_action_steps)

    def update(self) -> None:
        """Move the average; lerobot calls this after each step of the optimizer."""
        self.updates += 1
        follow(self.average, self.network, ramped(self.config.ema_decay, int(self.updates)))

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """The flow-matching loss of a normalized batch: a number, or with reduction `none` (B,) for weighted data.

        `action` is (B, K, A), `action_is_pad` (B, K) says what lies behind the episode's end and does not count.
        """
        draws = self.config.draws
        network = self.network if self.training else self.average
        encoded = self._encode(network, batch).repeat_interleave(draws, 0)
        actions = batch[ACTION].repeat_interleave(draws, 0)
        padding = batch.get(PADDING)
        valid = torch.ones_like(actions[..., 0])
        if padding is not None:
            valid = (~padding).to(actions.dtype).repeat_interleave(draws, 0)
        noise = torch.randn_like(actions)
        tau = torch.rand(len(actions), dtype=actions.dtype, device=actions.device)
        velocity = network(encoded, interpolate(actions, noise, tau), tau)
        losses = flow_loss(velocity, actions, noise, valid).unflatten(0, (-1, draws)).mean(1)
        loss = losses if reduction == "none" else losses.mean()
        return loss, {"flow_loss": float(losses.detach().mean())}

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None, **_unused: Any) -> Tensor:
        """Normalized chunks (B, K, A) of a normalized batch, from noise (B, K, A), drawn where none is given.

        With noise (B, N, K, A), N candidates for each observation: (B, N, K, A); the observation is encoded once.
        """
        encoded = self._encode(self.average, batch)
        assert self.config.action_feature is not None
        shape = (self.config.chunk_size, self.config.action_feature.shape[0])
        if noise is None:
            noise = torch.randn(len(encoded), *shape, dtype=encoded.dtype, device=encoded.device)
        if noise.shape[-2:] != shape or len(noise) != len(encoded) or noise.ndim not in (3, 4):
            raise UsageError(
                f"noise has the shape {tuple(noise.shape)}; for {len(encoded)} observations it must be "
                f"{(len(encoded), *shape)}, or {(len(encoded), 'N', *shape)} for N candidates."
            )
        noise = noise.to(encoded)
        candidates = noise.shape[1] if noise.ndim == 4 else 1
        chunks = integrate(
            self.average, encoded.repeat_interleave(candidates, 0), noise.reshape(-1, *shape), self.config.num_steps
        )
        return self.levels(chunks).reshape(noise.shape)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None, **_unused: Any) -> Tensor:
        """The next action (B, A), normalized: of the chunk that is being executed, or the first of a new one."""
        if not self._left:
            chunk = self.predict_action_chunk(batch, noise)
            self._left.extend(chunk[:, : self.config.n_action_steps].unbind(1))
        return self._left.popleft()

    def _encode(self, network: FlowNetwork, batch: dict[str, Any]) -> Tensor:
        parts = []
        for key, size in self.config.observed().items():
            if key not in batch or batch[key].shape[-1] != size:
                there = tuple(batch[key].shape) if key in batch else "nothing"
                raise UsageError(f"{key} must have {size} numbers, as in training; the batch has {there}.")
            # With a history of one, lerobot may keep its axis: (B, 1, n).
            parts.append(batch[key] if batch[key].ndim == 2 else batch[key][:, -1])
        limit = self.config.observation_limit
        observed = torch.cat(parts, dim=-1).clamp(-limit, limit)
        return network.encode(observed, self._tasks(batch.get("task"), observed))

    def _tasks(self, said: str | Sequence[str] | None, like: Tensor) -> Tensor:
        """(B, T): one 1 at each instruction's place; zeros for one that training did not have, white space aside."""
        told = [said] * len(like) if isinstance(said, str) or said is None else list(said)
        if len(told) == 1 and len(like) > 1:
            told = told * len(like)
        known = {instruction.strip(): place for place, instruction in enumerate(self.config.instructions)}
        tasks = like.new_zeros(len(like), len(self.config.instructions))
        for row, instruction in enumerate(told):
            place = known.get((instruction or "").strip())
            if place is not None:
                tasks[row, place] = 1
        return tasks
