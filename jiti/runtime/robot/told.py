"""Where an arm would go, in words."""

from collections.abc import Callable
from typing import Any

from jiti.runtime.robot.tick import Arrived, Tick, Watcher

SAID_S = 0.5


class Told(Watcher):
    """Says twice a second where the arm would be sent."""

    def __init__(self, say: Callable[[str], None], joints: tuple[str, ...]) -> None:
        self._say, self._joints, self._said_ns = say, joints, 0

    def ticked(self, tick: Tick) -> None:
        if tick.asked is None or tick.time_ns - self._said_ns < SAID_S * 1e9:
            return
        self._said_ns = tick.time_ns
        seen: Any = tick.seen
        places = (f"{name} {seen[f'{name}.pos']:.0f} -> {tick.asked[name]:.0f}" for name in self._joints)
        held_back = f" (held back: {', '.join(tick.clamped)})" if tick.clamped else ""
        self._say(f"step {tick.tick}: {', '.join(places)}{held_back}")

    def arrived(self, arrived: Arrived) -> None:
        pass
