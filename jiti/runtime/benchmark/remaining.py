"""How far a chain of stages is, and about how long the rest takes."""

from collections.abc import Mapping
from time import monotonic

from jiti.progress import Progress
from jiti.runtime.benchmark.stages import KINDS, Kind

CORE_S: Mapping[Kind, float] = {
    "record": 4.0,
    "autolabel": 0.05,
    "curate": 0.1,
    "critics": 0.027,
    "values": 0.01,
    "policies": 0.05,
    "tau": 3.0,
    "rollouts": 3.0,
}
"""Seconds of a core for an episode, or for a step of training. Measured on one machine, and only the start: what the
run itself takes corrects them."""


class Remaining:
    """Told the share of the kind at work, it tells the share of all, and the time that is left."""

    def __init__(self, units: Mapping[Kind, float], workers: int, report: Progress) -> None:
        """`units`: what is still to do of each kind, in episodes or steps."""
        self._cost = {kind: units.get(kind, 0.0) * CORE_S[kind] / workers for kind in KINDS}
        self._report = report
        self._spent_s = dict.fromkeys(KINDS, 0.0)
        self._share = dict.fromkeys(KINDS, 0.0)
        self._began: tuple[Kind, float] | None = None

    def begin(self, kind: Kind) -> Progress:
        """What is told the share of this kind that is done."""
        self._began = (kind, monotonic())

        def tell(share: float, what: str) -> None:
            self._share[kind] = max(self._share[kind], min(1.0, share))
            assert self._began is not None
            self._spent_s[kind] = monotonic() - self._began[1]
            left = duration(self.left_s())
            self._report(self.share(), f"{what}; about {left} left")

        return tell

    def share(self) -> float:
        total = sum(self._cost.values())
        return sum(self._cost[kind] * self._share[kind] for kind in KINDS) / total if total else 1.0

    def left_s(self) -> float:
        """Kinds that have begun take as long as they did so far, the others as the average of those."""
        done = {kind: self._cost[kind] * self._share[kind] for kind in KINDS}
        spent, expected = sum(self._spent_s.values()), sum(done.values())
        usual = spent / expected if expected > 1 else 1.0
        left = 0.0
        for kind in KINDS:
            own = self._spent_s[kind] / done[kind] if self._share[kind] > 0.02 and done[kind] else usual
            left += self._cost[kind] * (1 - self._share[kind]) * own
        return left


def duration(seconds: float) -> str:
    """`40 s`, `12 min`, `2 h 5 min`"""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
