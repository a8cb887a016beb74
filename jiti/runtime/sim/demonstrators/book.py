"""Takes a book that stands upright and carries it: what the caddy and the shelf have in common."""

from collections.abc import Iterator

import numpy as np

from jiti.runtime.sim.demonstrators.grasp import half_turn
from jiti.runtime.sim.demonstrators.motion import CLOSE, OPEN, Demonstrator
from jiti.runtime.sim.scene import Scene
from jiti.runtime.sim.world import LEFT, RIGHT
from jiti.tasks.rotation import hand_down, rotation_vector

UP = np.array([0.0, 0.0, 1.0])
ATTEMPTS = 3
"""Times that a book is reached for. Our choice."""
BELOW_TOP_M = (0.006, 0.010)
"""How far under its top a book is held. The pads reach 4 mm lower and 12 mm higher; deeper, and the fingers would meet
the books beside it and the palm the rim of what it is put into."""
LONG_M = 0.15
"""A way that bends aside, as people's do."""


class BookCarrier(Demonstrator):
    """Speaks of the held book, not of the hand: of its foot, the middle of its lower end, and of its rotation.

    What is placed, and where, is the first thing that LIBERO's goal asks for.
    """

    def __init__(self, scene: Scene, *, careful: bool, random: np.random.Generator) -> None:
        super().__init__(scene, careful=careful, random=random)
        _, self.book, self.region = scene.goal[0]
        low, high = self.world.extent(self.book)
        self.size = high - low
        self._foot = np.array([*(low + high)[:2] / 2, low[2]])
        self.thin, self.wide = np.argsort(self.size[:2])

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3): the book's axes in the world; the third points from its lower end to its upper."""
        return self.world.rotation(self.book)

    @property
    def foot(self) -> np.ndarray:
        """(3,) m"""
        return self.world.position(self.book) + self.rotation @ self._foot

    @property
    def held(self) -> bool:
        """Whether both fingers touch the book."""
        return all(self.world.touching(finger, self.book) for finger in (LEFT, RIGHT))

    @property
    def grip_m(self) -> float:
        """How far above its foot the book is held, along its height."""
        return float((self.eef - self.foot) @ self.rotation[:, 2])

    def standing(self, line_rad: float) -> np.ndarray:
        """(3, 3): rotation of the upright book whose thin side lies at a yaw from the world's y axis, like the fingers
        of a hand at that yaw; of the two ways, the one that is nearer to how it is turned now."""
        yaw = self._thin_rad() + half_turn(line_rad - self._thin_rad())
        across = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        axes = np.empty((3, 3))
        axes[:, self.thin], axes[:, 2] = across, UP
        axes[:, self.wide] = np.cross(UP, across) if self.thin == 0 else np.cross(across, UP)
        return axes

    def pick(self, aside_m: float = 0.0) -> Iterator[np.ndarray]:
        """Take the book across its thin side, `aside_m` from the middle of its wide side towards the world's +x."""
        for _ in range(ATTEMPTS):
            along = self.rotation[:, self.wide]
            up = self.rotation[:, 2] * (self.size[2] - self.random.uniform(*BELOW_TOP_M))
            place = self.foot + up + along * np.copysign(aside_m, along[0] * aside_m)
            rotation = hand_down(half_turn(self._thin_rad()))
            above = place + UP * self.random.uniform(0.05, 0.09)
            yield from self.go(above, OPEN, rotation, near_m=0.01)
            yield from self.go(place, OPEN, rotation, near_m=0.003, speed=0.5, steady=True)
            yield from self.wait(int(self.random.integers(9, 13)), CLOSE)
            if self.held:
                return
            yield from self.wait(8, OPEN)

    def carry(
        self,
        foot: np.ndarray,
        rotation: np.ndarray | None = None,
        *,
        near_m: float = 0.01,
        near_rad: float = 0.05,
        patience: int = 60,
        speed: float | None = None,
        steady: bool = False,
    ) -> Iterator[np.ndarray]:
        """Move the hand as it must move for the book's foot to come to a place and the book to a rotation."""
        if rotation is None:
            rotation = self.rotation
        if not steady:
            yield from self._hesitate(CLOSE)
            if np.linalg.norm(foot - self.foot) > LONG_M:
                aside = self.temper.detour_m * self.random.uniform([-1, -1, 0], 1)
                middle = (self.foot + foot) / 2 + aside
                yield from self.carry(middle, rotation, near_m=0.04, near_rad=np.pi, speed=speed, steady=True)
        for _ in range(patience):
            turn = rotation @ self.rotation.T
            near = np.linalg.norm(foot - self.foot) < near_m
            if near and np.linalg.norm(rotation_vector(self.rotation, rotation)) < near_rad:
                return
            hand = foot + turn @ (self.eef - self.foot)
            yield self.towards(hand, CLOSE, turn @ self.eef_rotation, speed=speed, steady=steady)

    def let_go(self) -> Iterator[np.ndarray]:
        """Open the hand, draw it back and stand still until what was placed has come to rest."""
        yield from self.wait(int(self.random.integers(1, 4)), CLOSE)
        yield from self.wait(int(self.random.integers(8, 12)), OPEN)
        back = -self.eef_rotation[:, 2] * self.random.uniform(0.1, 0.13)
        yield from self.go(self.eef + back, OPEN, near_m=0.015, speed=0.7, steady=True)
        yield from self.wait(int(self.random.integers(10, 14)), OPEN)

    def _thin_rad(self) -> float:
        line = self.rotation[:2, self.thin]
        return float(np.arctan2(line[0], -line[1]))
