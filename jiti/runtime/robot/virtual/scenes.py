"""The six scenes of Table 7: the arm on a table with what each task needs, laid out anew from a seed.

`mjcf/<task>.xml` has the things where they lie on average.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from jiti.errors import UsageError
from jiti.nearest import nearest

FOLDER = Path(__file__).with_name("mjcf")


@dataclass(frozen=True, slots=True)
class Spread:
    """How far from its place a thing may lie, evenly to all sides, and how far it may be turned.

    Our choice: all of it within the arm's reach, and no two things of a scene can touch.
    """

    within_m: float
    within_rad: float


_FOOD, _DISH, _BLOCK = Spread(0.03, pi), Spread(0.02, pi), Spread(0.03, pi)
SCENES: Mapping[str, Mapping[str, Spread]] = {
    "so100/T0": {"carrot": _FOOD, "basket": _DISH},
    "so100/T1": {"corn": _FOOD, "plate": _DISH},
    "so100/T2": {"red_block": _BLOCK, "green_block": _BLOCK},
    "so100/T3": {"blue_block": _BLOCK, "yellow_block": _BLOCK},
    "so100/T4": {"bowl": _DISH, "plate": _DISH},
    "so100/T5": {"cabinet": Spread(0.01, 0.05)},
}
"""By task, what moves from one seed to the next."""
EMPTY = "empty"
"""Instead of a task: the arm alone."""

OPEN_M = (0.05, 0.08)
"""How far the drawer stands open at first. Our choice: all of it is within reach."""


def engine() -> Any:
    """MuJoCo. Raises UsageError where it is not installed."""
    try:
        import mujoco
    except ImportError as error:
        raise UsageError(f"the virtual arm moves in MuJoCo: {error}. Run: pip install 'jiti[robot]'") from error
    return mujoco


def load(task_id: str) -> Any:
    """The compiled model of a task's scene. Raises UsageError for a task that has none, or without MuJoCo."""
    if task_id != EMPTY and task_id not in SCENES:
        raise UsageError(f"the virtual arm has no scene for {task_id!r}; {nearest(task_id, SCENES)}")
    return engine().MjModel.from_xml_path(str(FOLDER / f"{task_id.removeprefix('so100/')}.xml"))


def lay_out(task_id: str, model: Any, data: Any, seed: int) -> None:
    """Put the things of a scene where the seed says, at rest, and leave the arm as it is.

    One seed always gives the same layout.
    """
    random = np.random.default_rng(seed)
    for name, spread in SCENES.get(task_id, {}).items():
        dx, dy = random.uniform(-spread.within_m, spread.within_m, 2)
        yaw = random.uniform(-spread.within_rad, spread.within_rad)
        body = model.body(name)
        place = body.pos + (dx, dy, 0)
        # Its quaternion after one about the upright axis.
        (w, x, y, z), c, s = body.quat, np.cos(yaw / 2), np.sin(yaw / 2)
        turn = np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
        if body.mocapid[0] >= 0:  # a piece of furniture
            data.mocap_pos[body.mocapid[0]], data.mocap_quat[body.mocapid[0]] = place, turn
        else:
            joint = data.joint(body.jntadr[0])
            joint.qpos[:3], joint.qpos[3:], joint.qvel[:] = place, turn, 0
    if task_id == "so100/T5":
        drawer = data.joint("top_drawer")
        drawer.qpos[0], drawer.qvel[0] = random.uniform(*OPEN_M), 0
