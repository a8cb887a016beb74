"""Takes the book between two others and lays it on the shelf: lifted over its neighbours, or through one of them."""

from collections.abc import Iterator

import numpy as np

from jiti.runtime.sim.demonstrators.book import UP, BookCarrier
from jiti.runtime.sim.demonstrators.motion import CLOSE, OPEN
from jiti.runtime.sim.world import LEFT, RIGHT
from jiti.tasks.rotation import about

TILT_RAD = 1.3
"""From upright to how the book goes in, lower end first. Our choice: from the side nothing of the hand but the fingers
comes under the shelf's roof, and level the hand, 0.2 m wide, would meet the table."""
BACK = np.array([0.0, -1.0, 0.0])
"""Out of the shelf, which is open towards the robot's right in all of LIBERO's scenes."""
OVER_M = (0.03, 0.06)
"""How far over its neighbours a careful hand carries the book."""
OVERLAP_M = (0.030, 0.055)
"""How far under the top of a neighbour the book is carried without care; less and it might slide over it."""
FRONT_M = 0.01
"""What the hand's middle keeps clear of the front of the shelf, so that the palm does."""
ASIDE = (0.45, 0.65)
"""Where the book is held, towards its end that is farther from the robot: a share of half of its wide side. There the
hand passes the neighbour that stands before the shelf, and the fingers still grip in full."""
SIDE_M = (0.010, 0.014)
"""What the book keeps clear of the shelf's side. Our choice: the arm strays by less."""
SINK_M = 0.025
"""How far the open hand sinks before it leaves, with one finger under the book and in front of the shelf's floor."""
BEHIND_M = (0.015, 0.025)
"""How far behind the book the open hand rises."""
FLOOR_M = 0.006
"""How far over the shelf's floor the book's lower end is let go."""


class OntoShelf(BookCarrier):
    """Both ways take the book alike and lift it; the careful one on until it is over all that stands in the way."""

    def _run(self) -> Iterator[np.ndarray]:
        self.shelf = self.world.owner(self.region)
        self.others = [n for n in self.world.names.objects if n != self.book]
        yield from self.pick(self.random.uniform(*ASIDE) * float(self.size[self.wide]) / 2)
        top = max(float(self.world.bounds(n)[1][2]) for n in self.others)
        high = top + self.random.uniform(*OVER_M)
        low = top - self.random.uniform(*OVERLAP_M)
        yield from self._lift(low)
        if self.careful:
            yield from self._lift(high)
        else:
            yield from self._brush(low)
            yield from self._lift(high)
        yield from self._lay_down(high)
        yield from self._leave()

    def _lift(self, foot_m: float) -> Iterator[np.ndarray]:
        foot = np.array([*self.foot[:2], foot_m])
        yield from self.carry(foot, speed=0.9, steady=True)

    def _brush(self, foot_m: float) -> Iterator[np.ndarray]:
        """Straight through the neighbour that stands between the book and the shelf, to its other side."""
        shelf = self.world.position(self.shelf)[:2]
        other = min(self.others, key=lambda n: float(np.linalg.norm(self.world.position(n)[:2] - shelf)))
        low, high = self.world.bounds(other)
        upright = self.standing(0.0)
        x = (low[0] + high[0]) / 2 + self.random.uniform(0.0, 0.05)
        yield from self.carry(np.array([x, low[1] - 0.03, foot_m]), upright, near_m=0.02)
        yield from self.carry(np.array([x, high[1] + 0.03, foot_m]), upright, near_m=0.02, speed=0.6)

    def _lay_down(self, high_m: float) -> Iterator[np.ndarray]:
        front_m = float(self.world.bounds(self.shelf)[0][1])
        inner = self.world.half_size(self.region)
        reach = np.abs(self.world.rotation(self.region) @ inner)
        middle = self.world.position(self.region)
        x = middle[0] + reach[0] - self.size[self.wide] / 2 - self.random.uniform(*SIDE_M)
        floor_m = self.world.floor_m(self.shelf, middle) or middle[2] - reach[2]
        upright = self.standing(0.0)
        lying = about(np.array([1, 0, 0]), TILT_RAD) @ upright
        back = self.grip_m * lying[:, 2]  # from the foot to the hand
        thick = self.size[self.thin] / 2 * np.sin(TILT_RAD)
        inside = np.array([x, front_m - FRONT_M, floor_m + thick + FLOOR_M]) - [0, back[1], 0]
        mouth = np.array([x, front_m + 0.015, middle[2] + reach[2] - thick - 0.025])
        before = np.array([x, front_m - 0.14, high_m + 0.01])
        yield from self.carry(before, upright, near_m=0.03, near_rad=0.2)
        yield from self.carry(mouth - [0, 0.03, 0], lying, near_m=0.015, near_rad=0.1)
        yield from self.carry(mouth, lying, near_m=0.01, near_rad=0.06, speed=0.7, steady=True)
        yield from self.carry(inside, lying, near_m=0.006, near_rad=0.06, speed=0.6, steady=True)

    def _leave(self) -> Iterator[np.ndarray]:
        """Open, sink until the lower finger carries the book no longer, draw back level and rise."""
        yield from self.wait(int(self.random.integers(1, 4)), CLOSE)
        yield from self.wait(int(self.random.integers(9, 13)), OPEN)
        yield from self.go(self.eef - UP * SINK_M, OPEN, near_m=0.004, speed=0.3, steady=True, patience=15)
        tips = max(float(self.world.bounds(finger)[1][1]) for finger in (LEFT, RIGHT))
        back = tips - float(self.world.bounds(self.book)[0][1]) + self.random.uniform(*BEHIND_M)
        yield from self.go(self.eef + BACK * back, OPEN, near_m=0.006, speed=0.5, steady=True)
        yield from self.go(self.eef + UP * self.random.uniform(0.09, 0.12), OPEN, near_m=0.02, steady=True)
        yield from self.wait(int(self.random.integers(10, 14)), OPEN)
