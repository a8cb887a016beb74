"""Whose hand it is: how a person would do a task with a virtual arm, with more care or less.

Careless ways are those that the task's constraint names as failures.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.robot.virtual.hand import Path, smooth, wander
from jiti.runtime.robot.virtual.reach import Reach
from jiti.runtime.robot.virtual.world import MOUNTS, REST_RAD, State
from jiti.runtime.sim.demonstrators import is_careful

REST = np.array([REST_RAD.get(name, 0.0) for name in MOUNTS])
FOLDED = np.array([0.0, -1.0, 1.5, -1.0, 0.0, 0.0])
"""Lifted off the base, so that the pan is free, and the fingers 21 cm over the table."""
HANDLE_M = np.array([-0.016, 0.0, 0.112])
"""The drawer's handle where it is shut, in the cabinet's frame, in which it opens along -x: mjcf/T5.xml."""
PITCH_RAD = 0.6
"""How far the hand leans down. Our choice: so the arm reaches a drawer that stands wide open."""
BEFORE_M = 0.02
"""From the handle at first. Our choice: the fingers come down there."""
PRESS_M = 0.004
"""How far beyond where it is shut it is pushed. Our choice: an arm in a spring's hand stays short of its place."""
WANDER_RAD = np.array([0.12, 0.12, 0.12, 0.12, 0.12, 0.0])
"""How far each joint strays at most on the way to the handle; the jaw stays shut. Our choice: no two ways are alike, as
with people, and who learns from them sees how one comes back. The fingers stray 1 to 5 cm, above all that is there."""
POINTS = 40
"""On a straight way, whose joints are in between."""


@dataclass(frozen=True, slots=True)
class Demonstration:
    path: Path
    manner: str
    """`careful`, or what goes wrong."""


Script = Callable[[State, np.random.Generator, str], Path]


def close_drawer(state: State, random: np.random.Generator, manner: str) -> Path:
    """From where the arm is to the drawer, which is pushed shut, and away from it."""
    reach, world_T_cabinet = Reach(), state.objects["cabinet"]
    handle = HANDLE_M + [0, random.uniform(-0.01, 0.01), random.uniform(-0.003, 0.003)]

    def at(open_m: float) -> np.ndarray:
        """The joints that have the fingers where the handle is then."""
        return reach.angles((world_T_cabinet @ [*(handle - [open_m, 0, 0]), 1.0])[:3], PITCH_RAD)

    def push(start_m: float, end_m: float, speed_m_s: float) -> Path:
        ways = [at(open_m) for open_m in np.linspace(start_m, end_m, POINTS)]
        return smooth(ways, abs(start_m - end_m) / speed_m_s)

    opened = state.drawers["top_drawer"]
    before, shut = opened + BEFORE_M, -PRESS_M
    folded = FOLDED + [at(before)[0], 0, 0, 0, 0, 0]
    path = smooth([now(state), FOLDED], 1.5).then(smooth([FOLDED, folded], random.uniform(0.8, 1.1)))
    path = wander(path.then(smooth([folded, at(before)], 1.0)), WANDER_RAD, random)
    speed = random.uniform(0.04, 0.05)
    if manner == "stops on the way":
        halfway = opened * random.uniform(0.4, 0.6)
        path = path.then(push(before, halfway, speed)).then(smooth([at(halfway)] * 2, random.uniform(0.6, 1.0)))
        path = path.then(push(halfway, shut, speed))
    elif manner == "slams it":
        path = path.then(push(before, shut, random.uniform(0.22, 0.3)))
    else:
        if manner == "leaves a gap":
            shut = random.uniform(0.012, 0.02)
        path = path.then(push(before, shut, speed))
    path = path.then(smooth([at(shut)] * 2, 0.3))
    return path.then(smooth([at(shut), folded], 1.2))


_SCRIPTS: Mapping[str, tuple[Script, tuple[str, ...]]] = {
    "so100/T5": (close_drawer, ("stops on the way", "slams it", "leaves a gap")),
}
"""By task, how it is done, and in which careless ways."""


def check_script(task_id: str) -> None:
    """Raises UsageError for a task that no one demonstrates on a virtual arm."""
    if task_id not in _SCRIPTS:
        raise UsageError(
            f"no one demonstrates {task_id} on a virtual arm; the hand there knows: {', '.join(_SCRIPTS)}. "
            "Lead the virtual arm with a real one: pass its port as --leader."
        )


def demonstrate(task_id: str, state: State, seed: int, quality: float) -> Demonstration:
    """How the task is done from a state, in the manner of a seed. Raises UsageError where no one knows."""
    check_script(task_id)
    script, careless = _SCRIPTS[task_id]
    random = np.random.default_rng([seed, 1])
    manner = "careful" if is_careful(seed, quality) else str(random.choice(careless))
    return Demonstration(script(state, random, manner), manner)


def home(state: State) -> Path:
    """Back to where an arm rests, past what stands in front of it."""
    start = now(state)
    folded = FOLDED + [start[0], 0, 0, 0, 0, 0]
    turn_s = 0.5 + abs(start[0]) / 0.8
    return smooth([start, folded], 1.2).then(smooth([folded, FOLDED], turn_s)).then(smooth([FOLDED, REST], 1.5))


def now(state: State) -> np.ndarray:
    """(6,), in the servos' order."""
    return np.array([state.joints[name] for name in MOUNTS])
