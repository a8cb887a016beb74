"""What a feature extractor is, and how one is opened by name."""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from jiti.errors import UsageError

if TYPE_CHECKING:
    import torch

Batch = Mapping[str, Any]
"""Observations of B frames, as LeRobotDataset's items are after torch's default collation: `observation.state` (B, n)
and `observation.environment_state` (B, n) float32, `observation.images.<camera>` (B, 3, H, W) float32 in 0 to 1,
`task` a list of B instructions. It has at least the keys of the extractor's `needs`."""

Shapes = Mapping[str, tuple[int, ...]]
"""What observations there are: a dataset's (or an environment's) features by name, with the shape of one frame."""

KINDS = {
    "state": "jiti.critic.features.state",
    "smolvla": "jiti.critic.features.smolvla",
    "groot": "jiti.critic.features.groot",
    "policy": "jiti.critic.features.policy",
}
"""Kinds of extractors, and the module of each, which has `open_extractor(argument, shapes, device)`."""


class FeatureExtractor(Protocol):
    """Observations to features, frozen: the same observation gives the same features, in whatever batch it comes.

    `features` of B frames has shape (B, tokens, size), in float32 or bfloat16, on any device, without gradients. A
    token that is zero throughout is padding: what has fewer than `tokens` is filled up with them.
    """

    @property
    def name(self) -> str:
        """The text that opens it again: `state`, `smolvla:lerobot/smolvla_base`."""
        ...

    @property
    def size(self) -> int:
        """Numbers of one token."""
        ...

    @property
    def tokens(self) -> int:
        """Tokens of one frame; 1 where an observation is one vector."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hex digest of all that features depend on beside the observation: weights, options, the code's version."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Keys of a batch that are read; without a picture among them, no video is decoded."""
        ...

    def features(self, batch: Batch) -> "torch.Tensor":
        """Features (B, tokens, size) of a batch."""
        ...


def open_extractor(name: str, shapes: Shapes, *, device: str = "cpu") -> FeatureExtractor:
    """The extractor of a name: `state`, or `KIND:PATH_OR_HUB_ID`. Raises UsageError for one that cannot be opened."""
    kind, _, argument = name.partition(":")
    if kind not in KINDS:
        raise UsageError(f"--features {name}: no such kind. There are: state, and {', '.join(_EXAMPLES)}.")
    if (kind == "state") == bool(argument):
        wanted = "stands alone" if kind == "state" else "needs a folder or Hub id: " + _example(kind)
        raise UsageError(f"--features {name}: {kind} {wanted}.")
    return import_module(KINDS[kind]).open_extractor(argument, shapes, device)


_EXAMPLES = ("smolvla:lerobot/smolvla_base", "groot:nvidia/GR00T-N1.5-3B", "policy:PATH_OR_HUB_ID")


def _example(kind: str) -> str:
    return next(example for example in _EXAMPLES if example.startswith(kind))
