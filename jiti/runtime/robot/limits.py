"""What may be sent to an arm: every joint, as a number, within its range, and not far from the goal before."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

from jiti.errors import RobotError

if TYPE_CHECKING:
    from lerobot.motors.feetech import FeetechMotorsBus

GRIPPER = "gripper"
Joints = Mapping[str, float]
"""Degrees by joint, from the middle of its range; the gripper in percent of it, 100 is open."""


@dataclass(frozen=True, slots=True)
class Checked:
    """A goal that may be sent."""

    goal: dict[str, float]
    clamped: tuple[str, ...]
    """Joints that were asked for more."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Lowest and highest by joint, in the servos' order."""

    low: Joints
    high: Joints
    max_step: float

    def check(self, asked: Joints, before: Joints) -> Checked:
        """What of `asked` may follow the goal `before`: within the range first, then within a step.

        Raises RobotError for a joint that is missing, unknown, or no number; nothing is sent then.
        """
        if missing := [name for name in self.low if name not in asked]:
            raise RobotError(f"an action lacks {', '.join(missing)}: the policy is of another robot. Pass its own.")
        if unknown := [name for name in asked if name not in self.low]:
            raise RobotError(
                f"an action has {', '.join(unknown)}, which this arm has not: pass a policy of this robot."
            )
        for name in self.low:
            if not isfinite(asked[name]):
                raise RobotError(
                    f"an action has {asked[name]} for {name}, which is no place to go to, and was not sent. "
                    "Train the policy again, or pass another --policy."
                )
        goal = {}
        for name, low in self.low.items():
            inside = min(max(asked[name], low), self.high[name])
            goal[name] = min(max(inside, before[name] - self.max_step), before[name] + self.max_step)
        return Checked(goal, tuple(name for name in goal if goal[name] != asked[name]))


def limits_of(bus: "FeetechMotorsBus", max_step: float) -> Limits:
    """The ranges that a calibration gives, in lerobot's degrees: 360 for all steps of the encoder but one."""
    low, high = {}, {}
    for name, motor in bus.motors.items():
        found = bus.calibration[name]
        half = (found.range_max - found.range_min) / 2 * 360 / (bus.model_resolution_table[motor.model] - 1)
        low[name], high[name] = (0.0, 100.0) if name == GRIPPER else (-half, half)
    return Limits(low, high, max_step)
