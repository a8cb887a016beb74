"""The joints that bring the fingertips to a place: the inverse of the arm's geometry, which is that of its MJCF model.

All joints but the pan and the roll turn about one direction, so seen from the side it is a chain in a plane: upper arm,
lower arm, hand. There a direction is its lean from the vertical, and positive angles lean forward.
"""

from math import acos, atan2, hypot
from typing import Any

import numpy as np

from jiti.runtime.robot.virtual.scenes import EMPTY, load


class Reach:
    def __init__(self) -> None:
        model: Any = load(EMPTY)
        place = {name: model.body(name).pos for name in ("shoulder", "upper_arm", "lower_arm", "wrist", "gripper")}
        jaw = model.geom("fixed_jaw")
        self._shoulder = _side(place["shoulder"] + place["upper_arm"])
        self._upper, self._lower = _side(place["lower_arm"]), _side(place["wrist"])
        self._hand = _side(place["gripper"] + jaw.pos + [jaw.size[0], 0, jaw.size[2]])
        self._ranges = np.array([model.joint(k).range for k in range(6)])

    def angles(self, tip: np.ndarray, pitch_rad: float) -> np.ndarray:
        """(6,) in radians, in the servos' order: the tips of the shut jaws at `tip` (3,), the hand leaning by a pitch.

        The nearest that the joints' ranges allow.
        """
        pan = -atan2(tip[1], tip[0])
        wrist = np.array([hypot(tip[0], tip[1]), tip[2]]) - _leant(self._hand, pitch_rad) - self._shoulder
        upper, lower = hypot(*self._upper), hypot(*self._lower)
        cosine = (wrist @ wrist - upper**2 - lower**2) / (2 * upper * lower)
        elbow = _lean(self._upper) - _lean(self._lower) + acos(min(max(cosine, -1.0), 1.0))
        lift = _lean(wrist) - _lean(self._upper + _leant(self._lower, elbow))
        found = np.array([pan, lift, elbow, pitch_rad - lift - elbow, 0.0, 0.0])
        return np.clip(found, *self._ranges.T)


def _side(place: np.ndarray) -> np.ndarray:
    """Forward and up."""
    return place[[0, 2]]


def _lean(way: np.ndarray) -> float:
    return atan2(way[0], way[1])


def _leant(way: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * way[0] + s * way[1], c * way[1] - s * way[0]])
