"""The robot's own state as policies for LIBERO take it: 8 numbers, the same that lerobot's LIBERO environment gives."""

import numpy as np

from jiti.runtime.sim.scene import Scene
from jiti.tasks.rotation import quaternion_xyzw

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
    w = float(np.clip(quaternion_xyzw[3], -1, 1))
    length = np.sqrt(max(0.0, 1 - w * w))
    return np.zeros(3) if length < 1e-10 else quaternion_xyzw[:3] * 2 * np.arccos(w) / length


def environment_state(scene: Scene) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and values (n,) float32 of where everything is: place and quaternion (xyzw, w not negative) of each object
    and fixture in the world, then how far each fixture's moving parts stand."""
    world = scene.world
    names: list[str] = []
    values: list[np.ndarray] = []
    for name in (*world.names.objects, *world.names.fixtures):
        pose = world.pose(name)
        names += [f"{name}.{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        values += [pose[:3, 3], quaternion_xyzw(pose)]
    for name in world.names.fixtures:
        joints = world.joints(name)
        names += [f"{name}.joint_{k}" for k in range(len(joints))]
        values.append(joints)
    return tuple(names), np.concatenate(values).astype(np.float32)
