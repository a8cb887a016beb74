"""One demonstration on an arm, at a fixed rate: observe, act, tell what is recorded."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, time_ns

from jiti.runtime.robot.keys import Keys
from jiti.runtime.robot.loop import Pace
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.tick import Tick, Watcher
from jiti.runtime.robot.ways import Way

ENTER, TIME, HAND, GIVEN_UP = "Enter", "time", "the hand was done", "to be recorded anew"
"""What ends one that is not stopped."""


@dataclass
class Take:
    arm: SafeArm
    way: Way
    keys: Keys
    watcher: Watcher
    over: Callable[[], bool]
    """Whether who demonstrates has come to an end."""
    steps: int = 0
    """Taken so far."""
    read: int = 0
    """Of these, those at which the arm could be read."""

    def run(self, seconds: float) -> str:
        """What ended it. The arm is ready, as its way wants it.

        Raises Stopped when everything is to stop, RobotError when it cannot go on.
        """
        settings = self.arm.settings
        pace, last_s = Pace(settings.period_s), float("nan")
        self.keys.look()  # keys of before do not count
        self.keys.anew()
        while self.steps < round(seconds * settings.fps):
            entered = self.keys.look()
            if self.keys.anew():
                return GIVEN_UP
            if entered:
                return ENTER
            if self.over():
                return HAND
            last_s = self._step(last_s)
            pace.wait()
        return TIME

    def _step(self, last_s: float) -> float:
        began_s, began_ns = perf_counter(), time_ns()
        seen = self.arm.observe()
        observed_s = perf_counter()
        acted = self.way.act(seen)
        sent_s = perf_counter()
        tick = Tick(
            self.steps,
            began_ns,
            seen,
            acted.asked,
            acted.sent,
            acted.clamped,
            self.arm.engaged,
            began_s - last_s,
            observed_s - began_s,
            sent_s - observed_s,
            sent_s - began_s,
        )
        self.way.tell(tick, self.watcher)
        self.steps += 1
        self.read += seen is not None
        return began_s
