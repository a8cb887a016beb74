"""What every kind of policy must do for candidates, and which kinds there are."""

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import torch

KINDS = {
    "state_flow": "jiti.runtime.candidates.state_flow",
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

    def look(self, prepared: dict[str, Any]) -> Any:
        """What is the same for every chunk of an observation; done once a decision."""
        ...

    def draw(self, looked: Any, noise: "torch.Tensor") -> "torch.Tensor":
        """Chunks (n, K, A) from noise (n, K', A'), in one batch."""
        ...
