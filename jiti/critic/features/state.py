"""Features from the dataset's own numbers: state vectors one behind the other. No model, so that it runs anywhere."""

import hashlib
from typing import TYPE_CHECKING

from jiti.critic.features.base import Batch, Shapes
from jiti.errors import UsageError

if TYPE_CHECKING:
    import torch

KEYS = ("observation.state", "observation.environment_state")
"""lerobot's names for the robot's state, and for the scene's where a simulator knows it."""


class StateFeatures:
    """The vectors of `KEYS` that there are, as they were recorded: the critic normalizes what it reads."""

    name = "state"
    tokens = 1

    def __init__(self, shapes: Shapes) -> None:
        self.needs = tuple(key for key in KEYS if key in shapes)
        if not self.needs:
            raise UsageError(
                f"--features state needs {' or '.join(KEYS)}; there are: {', '.join(sorted(shapes)) or 'none'}. "
                "Pass --features with a policy's name."
            )
        self.size = sum(shapes[key][0] for key in self.needs)
        columns = ",".join(f"{key}:{shapes[key][0]}" for key in self.needs)
        self.fingerprint = hashlib.sha256(f"state 1 {columns}".encode()).hexdigest()

    def features(self, batch: Batch) -> "torch.Tensor":
        import torch

        vectors = [torch.as_tensor(batch[key], dtype=torch.float32) for key in self.needs]
        return torch.cat(vectors, dim=-1).unsqueeze(1)


def open_extractor(argument: str, shapes: Shapes, device: str) -> StateFeatures:
    """Nothing is computed, so the device is of no matter."""
    return StateFeatures(shapes)
