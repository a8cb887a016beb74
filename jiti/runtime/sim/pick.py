"""A scripted pick: over the cube, turn, down, close, up; more or less carefully."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jiti.runtime.sim.lift import STEP_M, STEP_RAD, Observation

OPEN, CLOSE = -1.0, 1.0
HOVER_M = 0.08
"""Height over the cube's middle at which the hand is lined up. Our choice: the cube is in the wrist camera's view."""
LIFT_M = 0.16
"""How far the cube is raised; robosuite calls it lifted from 0.04 m over the table on."""
GAIN = 0.7
"""Share of the remaining way that one action asks for. Our choice: at 0.35 the last millimetres take too long."""
NOISE = 0.06
"""Standard deviation of the noise on the translation, in actions, so that episodes differ. Our choice."""
NEAR_M, NEAR_RAD = 0.006, 0.03
"""When a waypoint counts as reached. Our choice."""
PATIENCE_STEPS = 25
"""Steps after which a waypoint is left in any case. Our choice: the longest way takes 20."""
CLOSE_STEPS, HURRIED_CLOSE_STEPS = 12, 4
"""Steps of waiting for the fingers. The gripper needs 5 to 8 steps to close on the cube, measured."""
HOLD_STEPS = 10
"""Steps of stillness at the end. Our choice: half a second to look at the result."""


@dataclass(frozen=True, slots=True)
class Manner:
    """How carefully a pick is done; the default is as well as the script can."""

    aside_m: float = 0.0
    """How far from the cube's middle the fingers close, along the faces that they touch."""
    turned_rad: float = 0.0
    """By how much the hand stays turned from the cube's faces."""
    low_m: float = 0.0
    """How much deeper than the cube's middle the fingers reach; from about 0.02 on they press on the table."""
    hurried: bool = False
    """Rise before the fingers have closed."""


def draw_manner(random: np.random.Generator) -> Manner:
    """Each fault in about a third of the episodes, so that most have at most one and some have none."""
    faults = random.random(4) < 1 / 3
    return Manner(
        aside_m=float(random.choice([-1, 1]) * random.uniform(0.009, 0.012)) if faults[0] else 0.0,
        turned_rad=float(random.choice([-1, 1]) * random.uniform(0.25, 0.4)) if faults[1] else 0.0,
        low_m=0.03 if faults[2] else 0.0,
        hurried=bool(faults[3]),
    )


class ScriptedPick:
    """Proportional control through waypoints, one action an observation."""

    def __init__(self, manner: Manner, random: np.random.Generator) -> None:
        self._manner = manner
        self._random = random
        self._steps = self._run()
        self._seen: Observation | None = None

    def act(self, seen: Observation) -> np.ndarray | None:
        """The action (7,) in -1 to 1 for what is seen; None when the pick is over."""
        self._seen = seen
        return next(self._steps, None)

    def _run(self) -> Iterator[np.ndarray]:
        cube, hand = self._now.world_T_cube, self._now.world_T_hand
        rotation = grasp_rotation(cube[:3, :3], hand[:3, :3], self._manner.turned_rad)
        grasp = _above(cube[:3, 3] + rotation[:, 0] * self._manner.aside_m, -self._manner.low_m)
        yield from self._go(_above(grasp, HOVER_M), OPEN, rotation)
        yield from self._go(grasp, OPEN)
        for _ in range(HURRIED_CLOSE_STEPS if self._manner.hurried else CLOSE_STEPS):
            yield self._towards(grasp, CLOSE)
        yield from self._go(_above(grasp, LIFT_M), CLOSE)
        for _ in range(HOLD_STEPS):
            yield np.array([0, 0, 0, 0, 0, 0, CLOSE])

    @property
    def _now(self) -> Observation:
        if self._seen is None:
            raise RuntimeError("the script is asked for an action before it was shown anything")
        return self._seen

    def _go(self, place: np.ndarray, gripper: float, rotation: np.ndarray | None = None) -> Iterator[np.ndarray]:
        for _ in range(PATIENCE_STEPS):
            away = np.linalg.norm(place - self._now.world_T_hand[:3, 3])
            turn = 0.0 if rotation is None else np.linalg.norm(rotation_vector(self._now.world_T_hand, rotation))
            if away < NEAR_M and turn < NEAR_RAD:
                return
            yield self._towards(place, gripper, rotation)

    def _towards(self, place: np.ndarray, gripper: float, rotation: np.ndarray | None = None) -> np.ndarray:
        action = np.zeros(7)
        way = place - self._now.world_T_hand[:3, 3]
        action[:3] = way / STEP_M * GAIN + self._random.normal(0, NOISE, 3)
        if rotation is not None:
            action[3:6] = rotation_vector(self._now.world_T_hand, rotation) / STEP_RAD * GAIN
        # Where no rotation is asked for it is exactly zero, because only then does the controller hold the hand's pose.
        action[6] = gripper
        return np.clip(action, -1, 1)


def grasp_rotation(cube: np.ndarray, hand: np.ndarray, turned_rad: float) -> np.ndarray:
    """World rotation (3, 3) of a hand that points straight down, turned from the nearest of the cube's faces."""
    cube_yaw, hand_yaw = (float(np.arctan2(r[1, 0], r[0, 0])) for r in (cube, hand))
    quarter = np.pi / 2
    yaw = cube_yaw + quarter * round((hand_yaw - cube_yaw) / quarter) + turned_rad
    x, y = [np.cos(yaw), np.sin(yaw), 0], [np.sin(yaw), -np.cos(yaw), 0]
    return np.array([x, y, [0, 0, -1]]).T


def rotation_vector(world_T_hand: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3,) rad, world axes: the shortest turn of the hand to the target rotation (3, 3)."""
    turn = target @ world_T_hand[:3, :3].T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return axis * (0.5 if angle < 1e-6 else angle / (2 * np.sin(angle)))


def _above(place: np.ndarray, height_m: float) -> np.ndarray:
    return place + np.array([0, 0, height_m])
