"""How an arm is made to do what is recorded: it follows a leader, or a person moves it by hand."""

from dataclasses import dataclass
from typing import Protocol

from jiti.runtime.robot.limits import Joints
from jiti.runtime.robot.stops import Stops
from jiti.runtime.robot.tick import Seen, Tick, Watcher


@dataclass(frozen=True, slots=True)
class Acted:
    """What a step did."""

    asked: Joints | None
    """Where the leader was; None where there is none, or it could not be read."""
    sent: Joints
    clamped: tuple[str, ...] = ()


class Way(Protocol):
    """Of an open arm. Every method raises RobotError, and Stopped where it looks at the keys."""

    how: str
    """As recordings name it."""

    def begin(self, stops: Stops) -> None:
        """Be ready for the first step."""
        ...

    def act(self, seen: Seen | None) -> Acted:
        """One step, after it was observed."""
        ...

    def tell(self, tick: Tick, watcher: Watcher) -> None:
        """Have a step recorded, or the one before it, when its action is only known now."""
        ...

    def finish(self, watcher: Watcher) -> None:
        """Have recorded what is left, however it ended."""
        ...

    def end(self, stops: Stops) -> None:
        """After the last step: the arm is at rest then."""
        ...
