"""An arm without torque, which a person moves: the action of a step is where the joints are at the next one."""

from dataclasses import replace

from jiti.runtime.robot.limits import Joints
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.stops import Stops
from jiti.runtime.robot.tick import Seen, Tick, Watcher, state_of
from jiti.runtime.robot.ways import Acted, Way


class ByHand(Way):
    """Steps at which the arm cannot be read are left out."""

    how = "by hand"

    def __init__(self, arm: SafeArm) -> None:
        self._arm = arm
        self._last: Tick | None = None

    def begin(self, stops: Stops) -> None:
        self._last = None
        self._arm.begin_reading()

    def act(self, seen: Seen | None) -> Acted:
        return Acted(None, {} if seen is None else self._joints(seen))

    def tell(self, tick: Tick, watcher: Watcher) -> None:
        if tick.seen is None:
            return
        if self._last is not None:
            watcher.ticked(replace(self._last, sent=tick.sent))
        self._last = tick

    def finish(self, watcher: Watcher) -> None:
        """The last step's action is to stay where it is."""
        if self._last is not None:
            watcher.ticked(self._last)

    def end(self, stops: Stops) -> None:
        pass

    def _joints(self, seen: Seen) -> Joints:
        """To the last digit as they are recorded."""
        return dict(zip(self._arm.joints, state_of(seen, self._arm.joints).tolist(), strict=True))
