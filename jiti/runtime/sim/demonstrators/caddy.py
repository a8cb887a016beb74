"""Puts a book into a compartment of the caddy: parallel to its walls and down to its floor, or turned or tilted."""

from collections.abc import Iterator

import numpy as np

from jiti.runtime.sim.demonstrators.book import UP, BookCarrier
from jiti.runtime.sim.demonstrators.grasp import HAND_M, PALM_M, TIP_M
from jiti.tasks.rotation import about

TURNED_RAD = (0.18, 0.34)
"""How far a book is turned about the vertical without care. IsOrientationAligned bears 0.10 rad."""
TILTED_RAD = (0.18, 0.26)
"""The same about its wide side, so that it leans."""
FINGER_M, FINGERS_M = 0.027, 0.066
"""How thick a finger is, and half of what both take up when they are open, along the line between them. Collision
shapes of the Panda's hand in robosuite 1.4.0."""
PLAY_M = 0.003
"""What a turned book keeps clear of the walls on either side. Our choice: the arm strays by less."""
WALL_M = 0.004
"""What the hand keeps clear of the walls. Our choice, for the arm's noise."""
CLEAR_M = 0.03
"""How far over the caddy the book is carried there. Our choice."""
HOVER_M = (0.010, 0.025)
"""How far over the caddy's rim it is held before it is lowered."""
BOTTOM_M = (0.004, 0.008)
"""How far over the floor a careful hand lets go. LIBERO's `In` asks for 3.5 mm in the back compartment."""


class IntoCaddy(BookCarrier):
    """Both ways hold the book over the compartment a little turned or tilted; only the careful one aligns it there."""

    def _run(self) -> Iterator[np.ndarray]:
        self.caddy = self.world.owner(self.region)
        self.rim_m = float(self.world.bounds(self.caddy)[1][2])
        self._measure()
        yield from self.pick(self.random.uniform(-0.008, 0.008))
        yield from self.carry(np.array([*self.foot[:2], self.rim_m + CLEAR_M]), near_m=0.03)
        upright = self.standing(self._line_rad())
        crooked = self._crook(upright) @ upright
        over = np.array([*self.middle, self.rim_m + self.random.uniform(*HOVER_M)])
        yield from self.carry(over + UP * CLEAR_M, crooked, near_m=0.03, near_rad=0.1)
        yield from self.carry(over, crooked, near_m=0.004, near_rad=0.03, speed=0.6, steady=True)
        if self.careful:
            yield from self._insert(upright)
        else:
            yield from self._drop(crooked)
        yield from self.let_go()

    def _insert(self, upright: np.ndarray) -> Iterator[np.ndarray]:
        """Align, lower until the fingers would meet the walls, then beside them down to the floor."""
        over = np.array([*self.middle, self.foot[2]])
        yield from self.carry(over, upright, near_m=0.004, near_rad=0.03, speed=0.6, steady=True)
        yield from self._lower(self.middle, upright, self._tips_over_rim_m())
        at = self._beside_walls(upright)
        yield from self._lower(at, upright, self._tips_over_rim_m())
        bottom = self.floor_m + self.random.uniform(*BOTTOM_M)
        yield from self._lower(at, upright, max(bottom, self._palm_over_rim_m(0.0)))

    def _drop(self, crooked: np.ndarray) -> Iterator[np.ndarray]:
        """As it is held, as far down as the fingers have room, and let go there."""
        low = self._palm_over_rim_m(self._tilt_rad)
        if min(self.half) < FINGERS_M:
            low = max(low, self._tips_over_rim_m())
        yield from self._lower(self.middle, crooked, max(low, self.floor_m + BOTTOM_M[1]))

    def _lower(self, middle: np.ndarray, rotation: np.ndarray, foot_m: float) -> Iterator[np.ndarray]:
        foot = np.array([*middle, foot_m])
        yield from self.carry(foot, rotation, near_m=0.003, near_rad=0.03, patience=40, speed=0.5, steady=True)

    def _measure(self) -> None:
        """The compartment's floor, its walls along the world's x and y, and how high these are, with vertical rays."""
        start = self.world.position(self.region)
        self.floor_m = self.world.floor_m(self.caddy, start) or self.world.lowest_m(self.caddy)
        self.walls, self.tops = np.zeros((2, 2)), np.zeros((2, 2))
        for axis in range(2):
            for side, sign in enumerate((-1, 1)):
                self.walls[axis, side], self.tops[axis, side] = self._wall(start, axis, sign)
        self.middle = self.walls.mean(axis=1)
        self.half = (self.walls[:, 1] - self.walls[:, 0]) / 2

    def _wall(self, start: np.ndarray, axis: int, sign: int) -> tuple[float, float]:
        point = np.array([start[0], start[1], self.rim_m + 0.01])
        for _ in range(300):
            point[axis] += 0.001 * sign
            top = self.world.floor_m(self.caddy, point)
            if top is None or top > self.floor_m + 0.02:
                break
        inside = float(point[axis])
        point[axis] += 0.003 * sign
        top = self.world.floor_m(self.caddy, point)
        return inside, self.floor_m if top is None else top

    def _line_rad(self) -> float:
        """The yaw at which the book fits, and the fingers have most room."""
        along_x = self.size[self.wide] / 2 + PLAY_M < self.half[0] and self.half[1] > self.half[0]
        return 0.0 if along_x else np.pi / 2

    def _crook(self, upright: np.ndarray) -> np.ndarray:
        """(3, 3): how the book is turned or tilted before it is aligned."""
        across = int(np.argmax(np.abs(upright[:2, self.thin])))
        slot = 2 * (self.half[across] - PLAY_M)
        self._tilt_rad = 0.0
        if self.random.random() < 0.6:
            angles = np.linspace(*TURNED_RAD, 30)
            needed = self.size[self.thin] * np.cos(angles) + self.size[self.wide] * np.sin(angles)
            most = angles[needed < slot].max(initial=TURNED_RAD[0])
            return about(UP, self.random.choice([-1, 1]) * self.random.uniform(TURNED_RAD[0], most))
        self._tilt_rad = self.random.uniform(*TILTED_RAD)
        towards = 1.0 if self.tops[across, 1] <= self.tops[across, 0] else -1.0
        axis = np.cross(UP, np.eye(3)[across]) * towards
        return about(axis, self._tilt_rad)

    def _beside_walls(self, upright: np.ndarray) -> np.ndarray:
        """(2,) m: where the book's foot leaves room for the fingers beside walls that they come down beside."""
        across = int(np.argmax(np.abs(upright[:2, self.thin])))
        book = self.size[self.thin] / 2
        finger = book + FINGER_M
        tips_m = self.floor_m + self.grip_m - TIP_M
        needed = np.where(self.tops[across] > tips_m, finger, book)
        at = self.middle.copy()
        at[across] = (self.walls[across, 0] + needed[0] + self.walls[across, 1] - needed[1]) / 2
        return at

    def _tips_over_rim_m(self) -> float:
        """Height of the foot at which the fingertips are just above the walls."""
        return self.rim_m + TIP_M + WALL_M - self.grip_m

    def _palm_over_rim_m(self, tilt_rad: float) -> float:
        """Height of the foot at which the palm is."""
        reach = PALM_M * np.cos(tilt_rad) - HAND_M[1] * np.sin(tilt_rad)
        return float(self.rim_m + WALL_M - reach - self.grip_m * np.cos(tilt_rad))
