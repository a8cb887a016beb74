"""Features from GR00T: its vision-language backbone's tokens, and its encoding of the state.

Three tokens a frame: the mean of the pictures' tokens, the mean of the other tokens, and the state as the action head
encodes it. The shorter ones are filled up with zeros to one size. Supplement C.4 trains a critic on frozen GR00T-N1.5
features without saying which tokens; the means are our choice, as for SmolVLA.

lerobot 0.6.1 opens GR00T-N1.7 only, and names lerobot 0.5.1 for N1.5. Both have the same two parts, by the same names.
"""

import hashlib
from typing import TYPE_CHECKING, Any

from jiti.critic.features.base import Batch, Shapes
from jiti.critic.features.opened_policy import OpenedPolicy, open_policy
from jiti.critic.features.policy import first_output

if TYPE_CHECKING:
    import torch

VERSION = 1
"""Of this code: raise it when features change."""


class GrootFeatures:
    """Means of the backbone's tokens and the encoded state, (B, 3, size)."""

    tokens = 3

    def __init__(self, name: str, opened: OpenedPolicy) -> None:
        self.name = name
        self.needs = opened.needs
        self._opened = opened
        groot: Any = opened.policy
        self._backbone = groot._groot_model.backbone
        self._state = groot._groot_model.action_head.state_encoder
        sizes = (groot._groot_model.config.backbone_embedding_dim, groot._groot_model.config.input_embedding_dim)
        self.size = max(sizes)
        about = f"groot {VERSION} {opened.fingerprint} {sorted(opened.renamed.items())}"
        self.fingerprint = hashlib.sha256(about.encode()).hexdigest()

    def features(self, batch: Batch) -> "torch.Tensor":
        import torch

        seen = first_output(self._opened, self._backbone, batch)
        hidden, valid = seen["backbone_features"].float(), seen["backbone_attention_mask"]
        pictures = seen["image_mask"] & valid if "image_mask" in seen else valid
        state = first_output(self._opened, self._state, batch).float().flatten(1)
        parts = [_mean(hidden, pictures), _mean(hidden, valid & ~pictures), state]
        return torch.stack([torch.nn.functional.pad(p, (0, self.size - p.shape[-1])) for p in parts], dim=1)


def _mean(hidden: "torch.Tensor", which: "torch.Tensor") -> "torch.Tensor":
    """(B, L, D) and (B, L) -> (B, D); zeros where none is meant."""
    share = which.unsqueeze(-1).to(hidden.dtype)
    return (hidden * share).sum(1) / share.sum(1).clamp_min(1)


def open_extractor(argument: str, shapes: Shapes, device: str) -> GrootFeatures:
    """`argument` is a checkpoint's folder or Hub id. Raises UsageError, for N1.5 with lerobot's own advice."""
    return GrootFeatures(f"groot:{argument}", open_policy(argument, shapes, device, kind="groot"))
