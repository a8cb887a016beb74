"""What policies take of a scene in numbers: the robot's state, as in lerobot's LIBERO environment, and the things'."""

from collections.abc import Sequence

import numpy as np

from jiti.runtime.sim.scene import Scene
from jiti.runtime.sim.world import GRIPPER
from jiti.tasks.goal import atoms, parse_goal
from jiti.tasks.rotation import quaternion_xyzw
from jiti.tasks.scene_state import roles, scene_state

PROPRIO_NAMES = ("x", "y", "z", "rx", "ry", "rz", "finger_1", "finger_2")
"""Point between the fingertips in m, rotation of the hand as axis times angle in rad, fingers in m; world frame."""


def proprio(scene: Scene) -> np.ndarray:
    """(8,) float32, as lerobot 0.6.1's `LiberoProcessorStep` makes it of what its environment observes."""
    place, quaternion = scene.world_T_eef[:3, 3], scene.eef_quaternion_xyzw
    return np.concatenate([place, axis_angle(quaternion), scene.finger_m]).astype(np.float32)


def axis_angle(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """(3,) rad of a unit quaternion (4,), with an angle in 0 to 2 pi.

    lerobot's convention: w keeps its sign, so the angle passes pi smoothly, near which it is for a hand that points
    down, and where a shortest rotation vector would jump.
    """
    w = min(max(float(quaternion_xyzw[3]), -1.0), 1.0)
    length = np.sqrt(max(0.0, 1 - w * w))
    return np.zeros(3) if length < 1e-10 else quaternion_xyzw[:3] * 2 * np.arccos(w) / length


def scene_order(scene: Scene) -> list[str]:
    """Names of things in the order of their places in the vector of `scene_vector`."""
    world = scene.world
    regions = spoken_regions(scene)
    moved = [name for name in scene.interest if name in world.names.objects]
    return roles(scene.task, (*world.names.objects, *world.names.fixtures, *regions), moved=moved, regions=regions)


def scene_vector(scene: Scene, order: Sequence[str]) -> np.ndarray:
    """(n,) float32: where things are now, as `jiti.tasks.scene_state` has it of a recording."""
    world = scene.world
    turns = quaternion_xyzw(np.array([world.rotation(name) for name in order]))
    poses = np.concatenate([[world.position(name) for name in order], turns], axis=1)
    touched = (GRIPPER, order[0]) in world.contacts()
    joints = {name: world.joints(name)[None] for name in order if name in world.names.fixtures}
    hand_m = scene.world_T_eef[None, :3, 3]
    return scene_state(hand_m, dict(zip(order, poses[:, None], strict=True)), order, np.array([touched]), joints)[0]


def spoken_regions(scene: Scene) -> list[str]:
    """Places that the task or its ITCs speak of: where in a fixture something is to go."""
    spoken = [
        name for itc in scene.task.itcs if itc.goal for atom in atoms(parse_goal(itc.goal)) for name in atom.arguments
    ]
    return [name for name in dict.fromkeys((*scene.interest, *spoken)) if name in scene.world.names.regions]
