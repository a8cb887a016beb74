"""One observation as a batch of one, in lerobot's form."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jiti.critic.features.opened_policy import PICTURES

Observation = Mapping[str, np.ndarray]
"""lerobot's keys: `observation.state` (n,), `observation.environment_state` (m,), `observation.images.<camera>`
(H, W, 3) uint8."""


def as_batch(observation: Observation, instruction: str) -> dict[str, Any]:
    """Numbers (1, n) float32, pictures (1, 3, H, W) float32 in 0 to 1, `task` a list of one instruction."""
    import torch

    batch: dict[str, Any] = {"task": [instruction]}
    for key, value in observation.items():
        # A copy, so that nobody who changes the observation later changes what was seen.
        tensor = torch.from_numpy(np.array(value))
        if key.startswith(PICTURES):
            tensor = tensor.movedim(-1, -3) / 255
        batch[key] = tensor.float().unsqueeze(0)
    return batch


def shapes_of(observation: Observation) -> dict[str, tuple[int, ...]]:
    """The shape of each part, as extractors of features ask for it."""
    return {key: tuple(np.shape(value)) for key, value in observation.items()}
