"""How every scripted expert moves: proportional control through waypoints, with a temper of its own in each episode."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jiti.runtime.sim.scene import STEP_M, STEP_RAD, Scene
from jiti.tasks.rotation import rotation_vector

OPEN, CLOSE = -1.0, 1.0
"""Values of an action's gripper."""


@dataclass(frozen=True, slots=True)
class Temper:
    """How someone moves, whatever they do well or badly: constant within an episode, drawn anew for each."""

    gain: float = 0.7
    """Share of the remaining way that one action asks for."""
    speed: float = 1.0
    """Greatest length of an action's translation; 1 is 1 m/s commanded."""
    noise: float = 0.04
    """Standard deviation of the noise on the translation, in actions."""
    detour_m: float = 0.0
    """How far a long way bends aside at its middle."""
    hesitation: float = 0.0
    """Chance to stand still for a moment before a way begins."""


def draw_temper(random: np.random.Generator) -> Temper:
    """Our choice of ranges: what still succeeds, and looks as different as people do."""
    return Temper(
        gain=random.uniform(0.45, 0.8),
        speed=random.uniform(0.6, 1.0),
        noise=random.uniform(0.02, 0.06),
        detour_m=random.uniform(0.0, 0.03),
        hesitation=random.uniform(0.0, 0.3),
    )


class Demonstrator:
    """A scripted expert that sees all poses of the scene and gives one action (7,) a step until it is done.

    Subclasses write `_run`, a generator of actions that looks at `self.scene` as it goes. `careful` is how the episode
    is meant; how it turned out only the predicates tell.
    """

    def __init__(self, scene: Scene, *, careful: bool, random: np.random.Generator) -> None:
        self.scene, self.world, self.random, self.careful = scene, scene.world, random, careful
        self.temper = draw_temper(random)
        self._actions = self._run()

    def act(self) -> np.ndarray | None:
        """The action for the scene as it is now; None when the demonstration is over."""
        return next(self._actions, None)

    def _run(self) -> Iterator[np.ndarray]:
        raise NotImplementedError

    @property
    def eef(self) -> np.ndarray:
        """(3,) m: the point between the fingertips."""
        return self.scene.world_T_eef[:3, 3]

    @property
    def eef_rotation(self) -> np.ndarray:
        """(3, 3): z out of the hand, y from finger to finger."""
        return self.scene.world_T_eef[:3, :3]

    def go(
        self,
        place: np.ndarray,
        gripper: float,
        rotation: np.ndarray | None = None,
        *,
        near_m: float = 0.006,
        near_rad: float = 0.03,
        patience: int = 60,
        speed: float | None = None,
        steady: bool = False,
    ) -> Iterator[np.ndarray]:
        """Move to a place, and to a rotation where one is given, until near or out of patience (steps).

        `steady` leaves out detour, hesitation and most of the noise, for the last centimetres.
        """
        if not steady:
            yield from self._hesitate(gripper)
            yield from self._detour(place, gripper, rotation)
        for _ in range(patience):
            turn = 0.0 if rotation is None else np.linalg.norm(rotation_vector(self.eef_rotation, rotation))
            if np.linalg.norm(place - self.eef) < near_m and turn < near_rad:
                return
            yield self.towards(place, gripper, rotation, speed=speed, steady=steady)

    def wait(self, steps: int, gripper: float) -> Iterator[np.ndarray]:
        """Stand still."""
        for _ in range(steps):
            yield np.array([0, 0, 0, 0, 0, 0, gripper])

    def towards(
        self,
        place: np.ndarray,
        gripper: float,
        rotation: np.ndarray | None = None,
        *,
        speed: float | None = None,
        steady: bool = False,
    ) -> np.ndarray:
        """One action on the way to a place."""
        action = np.zeros(7)
        way = (place - self.eef) / STEP_M * self.temper.gain
        most = self.temper.speed if speed is None else speed
        length = float(np.linalg.norm(way))
        action[:3] = way * min(1.0, most / max(length, 1e-9))
        action[:3] += self.random.normal(0, self.temper.noise * (0.3 if steady else 1.0), 3)
        if rotation is not None:
            action[3:6] = rotation_vector(self.eef_rotation, rotation) / STEP_RAD * self.temper.gain
        # Where no rotation is asked for it is exactly zero, because only then does the controller hold the hand's pose.
        action[6] = gripper
        return np.clip(action, -1, 1)

    def _hesitate(self, gripper: float) -> Iterator[np.ndarray]:
        if self.random.random() < self.temper.hesitation:
            yield from self.wait(int(self.random.integers(2, 8)), gripper)

    def _detour(self, place: np.ndarray, gripper: float, rotation: np.ndarray | None) -> Iterator[np.ndarray]:
        """On a way of more than 15 cm, pass by a point beside or above its middle."""
        start, way = self.eef, place - self.eef
        length = float(np.linalg.norm(way))
        if length < 0.15 or self.temper.detour_m == 0:
            return
        aside = np.cross(way / length, self.random.normal(size=3))
        aside *= self.temper.detour_m / max(float(np.linalg.norm(aside)), 1e-9)
        aside[2] = abs(aside[2])  # never lower than the straight way
        middle = start + way / 2 + aside
        for _ in range(40):
            if np.linalg.norm(middle - self.eef) < 0.04:
                return
            yield self.towards(middle, gripper, rotation)
