"""Takes a thing and puts it into a basket or a tray or onto a plate: with care, or let go too high, or off centre."""

from collections.abc import Iterator

import numpy as np

from jiti.runtime.sim.demonstrators.grasp import HAND_M, PALM_M, TIP_M, choose_grasp, half_turn
from jiti.runtime.sim.demonstrators.motion import CLOSE, OPEN, Demonstrator
from jiti.runtime.sim.scene import Scene
from jiti.runtime.sim.world import LEFT, RIGHT
from jiti.tasks.rotation import hand_down

ATTEMPTS = 3
"""Times that a thing is reached for. Our choice."""
ASIDE_M = 0.004
"""How far from the best place a thing is taken, along its side. Our choice, so that no two grasps are alike."""
CLEARANCE_M = 0.04
"""Between what is carried, or the open fingers, and the highest thing on the way. Our choice."""
CORRIDOR_M = 0.12
"""Half the width of the way on which things count: a little more than half the hand."""
WALL_M = 0.005
"""What the palm keeps clear of the rim of a container that it does not fit into. Our choice, for the arm's noise."""
DROP_M = 0.035
"""The least fall of a thing that is let go early. IsOnBottomOf bears 0.020 m, and a hand that opens is late."""
ABOVE_RIM_M = (0.012, 0.05)
"""How far over the rim the origin of a thing is that is let go early. LIBERO's `In` asks for it to be below."""
BOTTOM_M = 0.003
"""How far over the bottom a careful hand lets go. Our choice: the arm is not precise enough for less."""


class Place(Demonstrator):
    """The sloppy way lets go over the rim; the careful one stops there too, and goes on down to the bottom.

    What is placed, and where, are the first two things that the task is about.
    """

    stray_m = (0.0, 0.008)
    """How far from the middle of the target the thing is held at first. Our choice: what a basket does not mind."""

    def __init__(self, scene: Scene, *, careful: bool, random: np.random.Generator) -> None:
        super().__init__(scene, careful=careful, random=random)
        self.thing, self.target = scene.interest[:2]

    def _run(self) -> Iterator[np.ndarray]:
        for _ in range(ATTEMPTS):
            yield from self._pick()
            if self.held:
                yield from self._carry()
            if self.held:
                yield from self._put()
                break
        yield from self._let_go()

    @property
    def held(self) -> bool:
        """Whether both fingers touch the thing."""
        return all(self.world.touching(finger, self.thing) for finger in (LEFT, RIGHT))

    def _pick(self) -> Iterator[np.ndarray]:
        grasp = choose_grasp(
            self.world, self.thing, self.target, depth=self.random.random(), hand_yaw_rad=self._hand_yaw_rad
        )
        rotation = hand_down(self._turn_to(grasp.yaw_rad))
        place = grasp.place + rotation[:, 0] * self.random.uniform(-ASIDE_M, ASIDE_M)
        above = place.copy()
        above[2] = max(above[2] + self.random.uniform(0.05, 0.09), self._clear_m(above) + TIP_M)
        if self.eef[2] < above[2]:
            yield from self.go(self._over(above[2] - self.eef[2]), OPEN, near_m=0.03)
        yield from self.go(above, OPEN, rotation, near_m=0.01)
        yield from self.go(place, OPEN, rotation, near_m=0.004, speed=0.6, steady=True)
        yield from self.wait(int(self.random.integers(10, 15)), CLOSE)
        yield from self.go(self._over(0.05), CLOSE, near_m=0.02, speed=0.4, steady=True)

    def _carry(self) -> Iterator[np.ndarray]:
        """To a place over the target from which it can be done well or badly."""
        self.rotation = hand_down(self._yaw_to_fit())
        self._stray = self._draw_stray()
        self._high = self._rim_m() + self.random.uniform(*ABOVE_RIM_M)
        hangs = self.world.position(self.thing)[2] - self.world.lowest_m(self.thing)
        self._high = max(self._high - hangs, self._bottom_m() + DROP_M + self.random.uniform(0, 0.03))
        over = max(self._clear_m(self.world.position(self.target)), self._high + 0.02)
        yield from self.go(self._over(over - self.world.lowest_m(self.thing)), CLOSE, near_m=0.03)
        way = np.array([*(self._goal + self._stray - self.world.position(self.thing)[:2]), 0.0])
        yield from self.go(self.eef + way, CLOSE, self.rotation, near_m=0.02)
        yield from self._bring(self._goal + self._stray, self._high, near_m=0.008)

    def _put(self) -> Iterator[np.ndarray]:
        if self.careful:
            yield from self._bring(self._goal, self._high)
            yield from self._bring(self._goal, self._bottom_m() + BOTTOM_M, speed=0.4)
        yield from self.wait(int(self.random.integers(1, 5)), CLOSE)

    def _let_go(self) -> Iterator[np.ndarray]:
        yield from self.wait(int(self.random.integers(8, 12)), OPEN)
        yield from self.go(self._over(self.random.uniform(0.1, 0.14)), OPEN, near_m=0.01, speed=0.6, steady=True)
        yield from self.wait(int(self.random.integers(10, 14)), OPEN)

    def _bring(
        self, goal: np.ndarray, lowest_m: float, *, near_m: float = 0.004, speed: float = 0.7
    ) -> Iterator[np.ndarray]:
        """Move the held thing until its origin is over a point (2,) and its lowest point at a height."""
        for _ in range(40):
            way = np.array([*(goal - self.world.position(self.thing)[:2]), lowest_m - self.world.lowest_m(self.thing)])
            way[2] = max(way[2], self._least_m() - self.eef[2])
            if np.linalg.norm(way) < near_m:
                return
            yield self.towards(self.eef + way, CLOSE, self.rotation, speed=speed, steady=True)

    def _over(self, by_m: float) -> np.ndarray:
        """(3,): straight above the hand, or below it."""
        return self.eef + np.array([0, 0, by_m])

    @property
    def _goal(self) -> np.ndarray:
        """(2,)"""
        return self.world.position(self.target)[:2]

    @property
    def _hand_yaw_rad(self) -> float:
        return float(np.arctan2(self.eef_rotation[1, 0], self.eef_rotation[0, 0]))

    def _turn_to(self, yaw_rad: float) -> float:
        """That yaw, or the opposite one: which leaves the wrist nearer to the middle of its range, at 0."""
        wrist, now = self.scene.joint_rad[-1], self._hand_yaw_rad
        turn = half_turn(yaw_rad - now)
        # The hand points down, so that its last joint turns against the yaw.
        return now + min((turn, turn + np.pi, turn - np.pi), key=lambda rad: abs(wrist - rad))

    def _draw_stray(self) -> np.ndarray:
        angle, far = self.random.uniform(0, 2 * np.pi), self.random.uniform(*self.stray_m)
        return far * np.array([np.cos(angle), np.sin(angle)])

    def _bottom_m(self) -> float:
        """Height of what the thing is put on, in the middle of the target."""
        over = self.world.position(self.target) + np.array([0, 0, 0.3])
        floor = self.world.floor_m(self.target, over)
        return self.world.lowest_m(self.target) if floor is None else floor

    def _rim_m(self) -> float:
        """Over which a thing is not in the target; LIBERO's region where the target has one."""
        for region, owner in self.world.names.regions.items():
            if owner == self.target:
                reach = np.abs(self.world.rotation(region) @ self.world.half_size(region))
                return float(self.world.position(region)[2] + reach[2])
        return float(self.world.bounds(self.target)[1][2])

    def _clear_m(self, place: np.ndarray) -> float:
        """Height at which a straight way to a place passes over everything that stands lower than the hand."""
        points = np.linspace(self.eef[:2], place[:2], 12)
        top = -np.inf
        for name in (*self.world.names.objects, *self.world.names.fixtures):
            low, high = self.world.bounds(name)
            near = np.maximum(0, np.maximum(low[:2] - points, points - high[:2]))
            if name != self.thing and low[2] < self.eef[2] and np.linalg.norm(near, axis=1).min() < CORRIDOR_M:
                top = max(top, float(high[2]))
        return top + CLEARANCE_M

    def _fits(self, yaw_rad: float) -> bool:
        """Whether the hand has room between the walls of the target."""
        low, high = self.world.extent(self.target)
        axes = self.world.rotation(self.target)[:2, :2].T @ hand_down(yaw_rad)[:2, :2]
        return bool(np.all(np.abs(axes) @ HAND_M < (high - low)[:2] / 2 - 0.015))

    def _yaw_to_fit(self) -> float:
        low, high = self.world.extent(self.target)
        axis = int(np.argmax((high - low)[:2]))
        line = self.world.rotation(self.target)[:2, axis]
        now, along = self._hand_yaw_rad, self._turn_to(float(np.arctan2(line[0], -line[1])))
        return along if self._fits(along) and not self._fits(now) else now

    def _least_m(self) -> float:
        """How low the point between the fingertips may come over the target."""
        rim = float(self.world.bounds(self.target)[1][2])
        return -np.inf if self._fits(self._hand_yaw_rad) else rim - PALM_M + WALL_M


class PlaceOffCentre(Place):
    """The sloppy way sets the thing down where it happens to be held; the careful one aligns it first."""

    stray_m = (0.016, 0.022)
    """In the middle between the 0.010 m that IsPreciselyOn bears and the 0.030 m that LIBERO's `On` asks for; what is
    set down ends up to 3 mm beside where it was held."""

    def _put(self) -> Iterator[np.ndarray]:
        goal = self._goal if self.careful else self._goal + self._stray
        yield from self._bring(goal, self._high)
        yield from self._bring(goal, self._bottom_m() + BOTTOM_M, speed=0.4)
        yield from self.wait(int(self.random.integers(1, 5)), CLOSE)
