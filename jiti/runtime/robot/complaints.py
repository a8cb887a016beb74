"""lerobot's and the system's errors on a line of servos, with what a person is to do about them."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jiti.errors import RobotError
from jiti.runtime.robot import servos

if TYPE_CHECKING:
    from lerobot.motors.feetech import FeetechMotorsBus

ARM, LEADER = "the arm", "the leader"
"""Whose line it is, where a message says so."""


@contextmanager
def explained(bus: "FeetechMotorsBus", who: str, what: str) -> Iterator[None]:
    """Of what fails at the beginning: `who` (the arm) `what` (cannot be opened)."""
    try:
        yield
    except (RuntimeError, *servos.SILENT) as error:
        remedy = "Check power and cables, and that nothing else uses the port."
        if "Missing motor IDs" in str(error):
            silent = servos.mute(bus)
            raise RobotError(
                f"{servos.told(bus, silent) or 'a servo'} does not answer at {bus.port}. Check the "
                "power, and the cable that leads to it."
            ) from error
        raise RobotError(f"{who} at {bus.port} {what}: {own_words(error)}. {remedy}") from error


def lost(bus: "FeetechMotorsBus", who: str, lost_s: float) -> RobotError:
    """Of an arm that could not be read for so long."""
    try:
        names = servos.mute(bus)
    except servos.CABLE_OUT:
        return cable_out(bus, who)
    if not names:
        return RobotError(f"{who}'s answers were damaged for {lost_s:g} s. Use another USB cable and supply.")
    following = " and those after it" if len(names) > 1 else ""
    whose = f" of {who}" if who == LEADER else ""
    return RobotError(
        f"{servos.told(bus, names)}{whose} does not answer. Check the cable that leads to "
        f"servo {bus.motors[names[0]].id}{following}, and the power."
    )


def cable_out(bus: "FeetechMotorsBus", who: str) -> RobotError:
    return RobotError(f"{bus.port} is gone in the middle of work: plug {who}'s USB cable in again.")


def own_words(error: BaseException) -> str:
    """Of lerobot's message, which may go over many lines, the first that says something."""
    return next((line.strip(" .!") for line in str(error).splitlines() if line.strip()), type(error).__name__)
