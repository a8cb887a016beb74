"""One step of an arm's loop, as it went: what is recorded and measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jiti.runtime.robot.inference import Answer
from jiti.runtime.robot.limits import Joints

Seen = Mapping[str, Any]
"""lerobot's observation: `<joint>.pos`, and pictures (height, width, 3) uint8 by camera."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Times in seconds."""

    tick: int
    """From 0 in each episode; the recording's frame."""
    time_ns: int
    """When it was observed, on the system's clock."""
    seen: Seen | None
    """None where the arm could not be read."""
    asked: Joints | None
    """The policy's action; None where there was none, and the arm was held."""
    sent: Joints
    clamped: tuple[str, ...]
    """Joints that were asked for more than they may."""
    begun: bool
    """Whether the first chunk had arrived."""
    period_s: float
    """Since the tick before; NaN at the first."""
    observe_s: float
    send_s: float
    busy_s: float
    """Of the whole tick, without the wait for the next."""

    @property
    def held(self) -> bool:
        """Whether the arm waited for a decision, or for a reading, in the middle of its work."""
        return self.begun and self.asked is None


@dataclass(frozen=True, slots=True)
class Arrived:
    """A decision, and when its chunk began to be executed."""

    answer: Answer
    tick: int
    dropped: int
    """Actions of the chunk that were over."""


class Watcher(Protocol):
    """Is told of an episode in the arm's loop: it must take no time."""

    def ticked(self, tick: Tick) -> None: ...

    def arrived(self, arrived: Arrived) -> None: ...


def state_of(seen: Seen, joints: tuple[str, ...]) -> np.ndarray:
    """(6,) float32, in the servos' order, as lerobot's datasets of this arm have it in `observation.state`."""
    return np.array([seen[f"{name}.pos"] for name in joints], np.float32)


def observation_of(seen: Seen, joints: tuple[str, ...], cameras: tuple[str, ...]) -> dict[str, np.ndarray]:
    """What a policy looks at, under the names of lerobot's datasets of this arm."""
    pictures = {f"observation.images.{camera}": seen[camera] for camera in cameras}
    return {"observation.state": state_of(seen, joints), **pictures}
