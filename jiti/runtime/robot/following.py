"""An arm that follows a leader."""

from jiti.runtime.robot.leader import Leader
from jiti.runtime.robot.limits import Joints
from jiti.runtime.robot.loop import RETURN_STEP, Pace, go_back, nearer
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.stops import Stops
from jiti.runtime.robot.tick import Seen, Tick, Watcher
from jiti.runtime.robot.ways import Acted, Way


class Following(Way):
    how = "leader"

    def __init__(self, arm: SafeArm, leader: Leader) -> None:
        self._arm, self._leader = arm, leader

    def begin(self, stops: Stops) -> None:
        """Go slowly to where the leader is, wherever it is moved meanwhile."""
        arm = self._arm
        arm.engage()
        self._rest = dict(arm.goal)
        self._leader.begin_reading()
        pace = Pace(arm.settings.period_s)
        while True:
            stops.look()
            arm.observe()
            wanted = self._leader.read()
            if wanted is None:
                arm.hold()
            elif self._go_nearer(wanted):
                return
            pace.wait()

    def act(self, seen: Seen | None) -> Acted:
        """Where the leader is, as far as the limits allow; the arm stays where either cannot be read."""
        arm, wanted = self._arm, self._leader.read()
        if seen is None or wanted is None:
            arm.hold()
            return Acted(None, arm.goal)
        clamped = arm.send(wanted).clamped
        return Acted(wanted, arm.goal, clamped)

    def tell(self, tick: Tick, watcher: Watcher) -> None:
        watcher.ticked(tick)

    def finish(self, watcher: Watcher) -> None:
        pass

    def end(self, stops: Stops) -> None:
        go_back(self._arm, stops, self._rest)
        self._arm.release()

    def _go_nearer(self, wanted: Joints) -> bool:
        """A slow step; whether it is there."""
        limits, goal = self._arm.limits, self._arm.goal
        place = {name: min(max(wanted[name], limits.low[name]), limits.high[name]) for name in goal}
        self._arm.send(nearer(goal, place))
        return all(abs(place[name] - goal[name]) <= RETURN_STEP for name in goal)
