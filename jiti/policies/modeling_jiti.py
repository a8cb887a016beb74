"""Just-in-Time Intervention around a frozen base policy, as a LeRobot policy that `lerobot-eval` opens from a folder.

The folder refers to base and critic and holds neither: both are frozen, so a copy of gigabytes would say nothing new, a
sweep over tau is a folder of two small files for each value, and a base keeps its own licence and place. Who wants all
in one folder puts both into it and names them by relative paths.
"""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch  # noqa: TID253 - lerobot's plugin, imported with the policy
from lerobot.policies.pretrained import PreTrainedPolicy  # noqa: TID253
from torch import Tensor  # noqa: TID253

from jiti.critic.features.opened_policy import PICTURES
from jiti.errors import UsageError
from jiti.policies.configuration_jiti import UNTRAINED, JitiConfig

if TYPE_CHECKING:
    from jiti.runtime.guidance import Decision, Guide


@dataclass(eq=False, slots=True)
class Episode:
    """What one environment's episode has going."""

    guide: "Guide"
    before: deque[dict[str, np.ndarray]]
    """The last observations, as many as the base policy looks back to."""
    left: deque[np.ndarray] = field(default_factory=deque)
    """Actions of the chunk that is being executed."""
    decisions: "list[Decision]" = field(default_factory=list)


class JitiPolicy(PreTrainedPolicy):
    """Acts in any number of environments side by side, each with decisions of its own. Trains nothing.

    lerobot finds this class by its name. `episodes` tells what was decided since the last `reset`.
    """

    config_class = JitiConfig  # pyright: ignore[reportAssignmentType] - lerobot declares it None
    name = "jiti"  # pyright: ignore[reportAssignmentType]

    def __init__(self, config: JitiConfig, **_unused: Any) -> None:
        """Opens base and critic. Raises UsageError or SourceError for what is missing or does not fit together."""
        from jiti.runtime.candidates import check_pair, open_sampler, open_scorer

        super().__init__(config)
        self.config: JitiConfig = config
        self.guidance = config.guidance
        if not config.base:
            raise UsageError("policy.base is empty; it names the policy that JITI is around: a folder or Hub id.")
        if self.guidance.method != "none" and not config.critic:
            raise UsageError(f"policy.critic is empty, and method {self.guidance.method} asks one: a folder or Hub id.")
        device = config.device or "cpu"
        sampler = open_sampler(config.found(config.base), device)
        self.scorer = open_scorer(config.found(config.critic), device) if config.critic else None
        self.executed = sampler.executed
        if self.scorer is not None:
            check_pair(sampler, self.scorer)
            # Actions that nobody executes or values need not be made.
            sampler = sampler.only(max(self.executed, self.scorer.chunk))
        self.sampler = sampler
        self._played = 0
        self.episodes: list[Episode] = []

    def reset(self) -> None:
        """Begin a new episode in every environment."""
        self._played += len(self.episodes)
        self.episodes = []

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **_unused: Any) -> Tensor:
        """The next action (B, A) of B environments, in the robot's units.

        Raises UsageError where their number changed without `reset`.
        """
        observations, told = _observations(batch)
        for episode, observation, instruction in zip(self._episodes(len(told)), observations, told, strict=True):
            if not episode.left:
                episode.left.extend(self._decide(episode, observation, instruction)[: self.executed])
            episode.before.append(observation)
        return self._tensor([episode.left.popleft() for episode in self.episodes])

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **_unused: Any) -> Tensor:
        """Chunks (B, K, A) of B environments, in the robot's units; each call is a decision."""
        observations, told = _observations(batch)
        chunks = []
        for episode, observation, instruction in zip(self._episodes(len(told)), observations, told, strict=True):
            chunks.append(self._decide(episode, observation, instruction))
            episode.before.append(observation)
        return self._tensor(chunks)

    def _decide(self, episode: Episode, observation: dict[str, np.ndarray], instruction: str) -> np.ndarray:
        seen = self.sampler.observe(observation, instruction, tuple(episode.before))
        scorer = self.scorer
        score = scorer.at(observation, instruction, seen) if scorer is not None else _unasked
        chunk, decision = episode.guide.decide(seen.sample, score)
        episode.decisions.append(decision)
        return chunk

    def _episodes(self, environments: int) -> list[Episode]:
        from jiti.runtime.guidance import Guide

        if not self.episodes:
            for number in range(self._played, self._played + environments):
                guide = Guide(self.guidance, self.config.seed + number, self.sampler.noise_shape)
                self.episodes.append(Episode(guide, deque(maxlen=max(0, self.sampler.history - 1))))
        if len(self.episodes) != environments:
            raise UsageError(
                f"{environments} environments act, and {len(self.episodes)} did before; call reset() between them."
            )
        return self.episodes

    def _tensor(self, rows: list[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.stack(rows)).to(self.config.device or "cpu")

    def forward(self, batch: dict[str, Tensor]) -> Any:
        raise UsageError(UNTRAINED)

    def get_optim_params(self) -> Any:
        raise UsageError(UNTRAINED)

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **options: Any) -> "JitiPolicy":  # pyright: ignore[reportIncompatibleMethodOverride]
        """The policy of a folder; there are no weights beside its config."""
        from lerobot.configs.policies import PreTrainedConfig

        config: Any = options.get("config") or PreTrainedConfig.from_pretrained(pretrained_name_or_path)
        config.pretrained_path = Path(pretrained_name_or_path)
        return cls(config).eval()

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        """The config alone. Folders are named by their absolute path, so that the new one may be anywhere."""
        from dataclasses import replace

        named = {name: _absolute(self.config.found(getattr(self.config, name))) for name in ("base", "critic")}
        replace(self.config, **named, pretrained_path=None)._save_pretrained(save_directory)


def _unasked(chunks: np.ndarray) -> np.ndarray:
    raise AssertionError("method none asks no critic")


def _absolute(reference: str) -> str:
    path = Path(reference).expanduser()
    return str(path.resolve()) if reference and path.is_dir() else reference


def _observations(batch: dict[str, Any]) -> tuple[list[dict[str, np.ndarray]], list[str]]:
    """Observations and instructions of B environments; pictures are bytes again, of which lerobot made 0 to 1."""
    seen: dict[str, np.ndarray] = {}
    for key, value in batch.items():
        if key.startswith("observation.") and isinstance(value, Tensor):
            if key.startswith(PICTURES):
                value = (value * 255).round().to(torch.uint8).movedim(-3, -1)
            seen[key] = value.cpu().numpy()
    environments = len(next(iter(seen.values()))) if seen else 0
    said = batch.get("task") or ""
    told = [said] * environments if isinstance(said, str) else list(said)
    return [{key: value[row] for key, value in seen.items()} for row in range(environments)], told
