"""Numbers of an action that take certain values only: a policy emits these values, and nothing near them.

A gripper is commanded by -1 or 1, and a rotation that demonstrations leave alone by exactly 0: robosuite's OSC_POSE
holds its goal orientation only while all rotation deltas are 0. Both show in a dataset's statistics.
"""

from collections.abc import Mapping
from typing import Any

import torch  # noqa: TID253 - imported with the policy only
from torch import Tensor, nn  # noqa: TID253

_NEAR = 1e-3
"""Share of the largest possible variance that may be missing where there are two values. Our choice: rounding of a
dataset's statistics over a million frames stays far below it."""


class Levels(nn.Module):
    """Which components of a normalized action (…, A) are put to a level, learned from the statistics of `action`.

    A component with two values only has the largest variance that its bounds allow: var = (max - mean)(mean - min)
    (Bhatia and Davis, 2000); it is emitted as the nearer of the two. One that never varies is emitted as it was.
    """

    low: Tensor
    high: Tensor

    def __init__(self, actions: int) -> None:
        super().__init__()
        missing = torch.full((actions,), torch.nan)
        self.register_buffer("low", missing.clone())
        self.register_buffer("high", missing.clone())

    def learn(self, stats: Mapping[str, Any]) -> None:
        """From min, max, mean and std (A,) of the data, in the action's unit; normalization by mean and std."""
        least, most, mean, std = (torch.as_tensor(stats[k]).double().flatten() for k in ("min", "max", "mean", "std"))
        largest = (most - mean) * (mean - least)
        two = (std.square() >= (1 - _NEAR) * largest) & (largest > 0)
        still = most == least
        scale = std.clamp_min(1e-8)
        self.low.copy_(torch.where(two, (least - mean) / scale, torch.where(still, 0.0, torch.nan)))
        self.high.copy_(torch.where(two, (most - mean) / scale, torch.where(still, 0.0, torch.nan)))

    def forward(self, chunk: Tensor) -> Tensor:
        """Normalized actions (…, A) with levels in their place."""
        nearer = torch.where((chunk - self.low).abs() <= (chunk - self.high).abs(), self.low, self.high)
        return torch.where(self.low.isnan(), chunk, nearer)
