"""Rotations as matrices (3, 3) and what is made of them: quaternions, rotation vectors, angles between things."""

from itertools import permutations, product

import numpy as np


def rotation_vector(now: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3,) rad, in the axes that both are given in: the shortest turn from one rotation (3, 3) to another."""
    turn = target @ now.T
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, (np.trace(turn) - 1) / 2))
    if sine > 1e-6:
        return axis * (angle / sine)
    if angle < 1:  # no turn, or nearly none
        return axis
    # Half a turn has no direction in the antisymmetric part; its axis is the column that stays.
    column = (turn + np.eye(3))[:, int(np.argmax(np.diag(turn)))]
    return column * (angle / np.linalg.norm(column))


def about(axis: np.ndarray, angle_rad: float) -> np.ndarray:
    """(3, 3): a turn about an axis (3,), right-handed (Rodrigues)."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross


def hand_down(yaw_rad: float) -> np.ndarray:
    """(3, 3): a hand that points straight down, with the line between its fingers at a yaw from the world's y axis."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, sin, 0], [sin, -cos, 0], [0, 0, -1]])


def quaternion_xyzw(pose: np.ndarray) -> np.ndarray:
    """(..., 4) unit quaternion of a rotation (..., 3, 3) or pose (..., 4, 4), w not negative (Bar-Itzhack 2000,
    version 3)."""
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = pose[..., :3, :3].T
    symmetric = np.array(
        [
            [xx - yy - zz, yx + xy, zx + xz, zy - yz],
            [yx + xy, yy - xx - zz, zy + yz, xz - zx],
            [zx + xz, zy + yz, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    quaternion = np.linalg.eigh(symmetric.T)[1][..., -1]
    return np.where(quaternion[..., 3:] >= 0, quaternion, -quaternion)


def matrices(quaternions_xyzw: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of quaternions (n, 4) of any length but 0."""
    x, y, z, w = (quaternions_xyzw / np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def turned_rad(rotations: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(n,) rad, 0 to pi: how far each rotation (n, 3, 3) is turned from one (3, 3)."""
    cosine = (np.einsum("nij,ij->n", rotations, start) - 1) / 2
    return np.arccos(np.clip(cosine, -1, 1))


def angle_between(one: np.ndarray, other: np.ndarray) -> float:
    """Angle in rad, 0 to pi, between two directions (3,)."""
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), np.dot(one, other)))


def angle_to_box(one: np.ndarray, other: np.ndarray) -> float:
    """Smallest turn in rad that makes the axes of one rotation (3, 3) parallel to those of another, in any order."""
    turns = (other.T @ one) @ _BOX.transpose(0, 2, 1)
    cosine = (np.trace(turns, axis1=1, axis2=2).max() - 1) / 2
    return float(np.arccos(np.clip(cosine, -1, 1)))


def _box_rotations() -> np.ndarray:
    """(24, 3, 3): the rotations that take a cube to itself."""
    found = [
        signs * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in (np.array(s)[:, None] for s in product((-1, 1), repeat=3))
    ]
    return np.array([m for m in found if np.linalg.det(m) > 0])


_BOX = _box_rotations()
