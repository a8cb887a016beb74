"""Candidates of GR00T-N1.7: its vision-language backbone and its encoding of the state once for all of them.

lerobot's `get_action_with_features` draws its noise itself and takes none, so its integration is written out here, with
the action head's own layers.
"""

from dataclasses import dataclass
from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened
from torch import Tensor  # noqa: TID253


@dataclass(frozen=True, slots=True)
class Looked:
    """What GR00T made of one observation."""

    hidden: Tensor
    """(1, L, D), the backbone's tokens."""
    seen: Tensor
    """(1, L, D), the same as the action head takes them."""
    state: Tensor
    """(1, 1, E)"""
    embodiment: Tensor
    """(1,)"""
    pictures: Tensor | None
    """(1, L): which tokens are of pictures."""
    valid: Tensor | None
    """(1, L): which tokens are no padding."""


class GrootSource:
    """The two halves of `GR00TN17.get_action`."""

    history = 1
    features_kind = "groot"

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self._model = policy._groot_model
        head = self._model.action_head
        self.noise_shape: tuple[int, int] = (head.action_horizon, head.action_dim)
        # As lerobot cuts it: a checkpoint may have learned fewer actions than the head emits.
        self.chunk: int = policy._resolve_prediction_horizon(torch.zeros(1, *self.noise_shape))

    def look(self, prepared: list[dict[str, Any]]) -> Looked:
        inputs = self._policy._filter_groot_inputs(prepared[-1], include_action=False)
        with self._precision():
            backbone_inputs, action_inputs = self._model.prepare_input(inputs)
            backbone = self._model.backbone(backbone_inputs)
            # `_encode_features` puts its own in their place.
            hidden = backbone["backbone_features"]
            features = self._model.action_head._encode_features(backbone, action_inputs)
        return Looked(
            hidden,
            features["backbone_features"],
            features["state_features"],
            action_inputs["embodiment_id"],
            backbone.get("image_mask"),
            backbone.get("backbone_attention_mask"),
        )

    def draw(self, looked: Looked, noise: Tensor, actions: int) -> Tensor:
        head, n = self._model.action_head, len(noise)
        shared: dict[str, Any] = {"encoder_hidden_states": looked.seen.expand(n, -1, -1)}
        if head.config.use_alternate_vl_dit:
            assert looked.pictures is not None
            assert looked.valid is not None
            shared["image_mask"] = looked.pictures.expand(n, -1)
            shared["backbone_attention_mask"] = looked.valid.expand(n, -1)
        embodiment, state = looked.embodiment.expand(n), looked.state.expand(n, -1, -1)
        chunks = noise.to(looked.seen.dtype)
        with self._precision():
            for step in range(head.num_inference_timesteps):
                bucket = int(step / head.num_inference_timesteps * head.num_timestep_buckets)
                time = torch.full((n,), bucket, device=chunks.device)
                tokens = head.action_encoder(chunks, time, embodiment)
                if head.config.add_pos_embed:
                    tokens = tokens + head.position_embedding(torch.arange(tokens.shape[1], device=chunks.device))
                out = head.model(hidden_states=torch.cat([state, tokens], dim=1), timestep=time, **shared)
                velocity = head.action_decoder(out, embodiment)[:, -head.action_horizon :]
                chunks = chunks + velocity / head.num_inference_timesteps
        return chunks[:, : self.chunk, : self._policy.config.output_features["action"].shape[0]]

    def features(self, looked: Looked, option: str) -> Tensor:
        """Tokens (1, 3, size) float32 as `jiti.critic.features.groot` makes them."""
        hidden = looked.hidden.float()
        valid = looked.valid if looked.valid is not None else hidden.new_ones(hidden.shape[:2]).bool()
        pictures = looked.pictures & valid if looked.pictures is not None else valid
        parts = [_mean(hidden, pictures), _mean(hidden, valid & ~pictures), looked.state.float().flatten(1)]
        size = max(part.shape[-1] for part in parts)
        return torch.stack([torch.nn.functional.pad(part, (0, size - part.shape[-1])) for part in parts], dim=1)

    def _precision(self) -> Any:
        kind = next(self._policy.parameters()).device.type
        return torch.autocast(device_type=kind, dtype=torch.bfloat16, enabled=self._policy.config.use_bf16)


def _mean(hidden: Tensor, which: Tensor) -> Tensor:
    """(1, L, D) and (1, L) -> (1, D); zeros where none is meant."""
    share = which.unsqueeze(-1).to(hidden.dtype)
    return (hidden * share).sum(1) / share.sum(1).clamp_min(1)


def open_source(policy: Any) -> GrootSource:
    return GrootSource(policy)
