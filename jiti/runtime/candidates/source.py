"""What every kind of policy must do for candidates, and which kinds there are."""

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    import torch

KINDS = {
    "state_flow": "jiti.runtime.candidates.state_flow",
    "smolvla": "jiti.runtime.candidates.smolvla",
    "pi0": "jiti.runtime.candidates.pi",
    "pi05": "jiti.runtime.candidates.pi",
    "groot": "jiti.runtime.candidates.groot",
    "diffusion": "jiti.runtime.candidates.diffusion",
    "multi_task_dit": "jiti.runtime.candidates.multi_task_dit",
}
"""Policies that draw chunks from noise, by lerobot's type, and the module of each, which has `open_source(policy)`."""


class Source(Protocol):
    """A policy seen as two halves: what it makes of an observation, and chunks that it makes of that and of noise.

    Both work on what lerobot's preprocessor gives, and give what its postprocessor takes. Neither touches the state of
    the policy or of torch's random generator.
    """

    @property
    def noise_shape(self) -> tuple[int, int]:
        """(K', A') of the noise of one chunk."""
        ...

    @property
    def chunk(self) -> int:
        """K, actions of a chunk, from the one that is due now on."""
        ...

    @property
    def history(self) -> int:
        """Observations that are looked at, the newest included."""
        ...

    def look(self, prepared: list[dict[str, Any]]) -> Any:
        """What is the same for every chunk; done once a decision. There are `history` observations, the newest last."""
        ...

    def draw(self, looked: Any, noise: "torch.Tensor", actions: int) -> "torch.Tensor":
        """Chunks (n, K, A) from noise (n, K', A'), in one batch, of which the first `actions` actions are wanted."""
        ...


@runtime_checkable
class SharesFeatures(Protocol):
    """A source whose view of an observation has a critic's features in it."""

    @property
    def features_kind(self) -> str:
        """The kind of extractor, a key of `jiti.critic.features.base.KINDS`, that gives the same of this policy."""
        ...

    def features(self, looked: Any, option: str) -> "torch.Tensor":
        """Features (1, T, D), with what stands behind # in the extractor's name."""
        ...
