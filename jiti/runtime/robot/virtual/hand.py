"""A hand that moves an arm without torque: a spring on each joint, no stronger than a person, pulls it along a path."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

STIFFNESS = 60.0
"""N m/rad. Our choice: under its own weight, 1 N m at most, the arm hangs a degree behind."""
DAMPING = 1.0
"""N m s/rad, of fingers and wrist. Our choice: nothing swings."""
STRENGTH_NM = 4.0
"""Our choice: 20 N at 20 cm from a joint."""
SAMPLE_S = 0.02
WAVES = 3
"""Whose mean a joint's way astray is. Our choice: no two are alike."""
WANDER_HZ = (0.2, 0.8)
"""Of a wave. Our choice: as slow as the way itself, so that it can be followed."""


@dataclass(frozen=True, slots=True)
class Path:
    """Where the joints are to be, and when."""

    times_s: np.ndarray
    """(N,), rising from 0."""
    angles_rad: np.ndarray
    """(N, 6), in the servos' order."""

    @property
    def lasts_s(self) -> float:
        return float(self.times_s[-1])

    def at(self, time_s: float) -> np.ndarray:
        """(6,); the last place after the end."""
        return np.array([np.interp(time_s, self.times_s, joint) for joint in self.angles_rad.T])

    def then(self, other: "Path") -> "Path":
        """The other one from the end on."""
        times = np.append(self.times_s, self.lasts_s + other.times_s[1:])
        return Path(times, np.concatenate([self.angles_rad, other.angles_rad[1:]]))


def smooth(places: Sequence[np.ndarray], lasts_s: float) -> Path:
    """Through places (6,), from rest to rest along their line with the least jerk (Flash and Hogan, 1985)."""
    times = np.linspace(0.0, lasts_s, max(2, round(lasts_s / SAMPLE_S) + 1))
    share = times / lasts_s
    progress = (10 * share**3 - 15 * share**4 + 6 * share**5) * (len(places) - 1)
    joints = np.array(places).T
    return Path(times, np.array([np.interp(progress, range(len(places)), joint) for joint in joints]).T)


def wander(path: Path, most_rad: np.ndarray, random: np.random.Generator) -> Path:
    """The path, with each joint astray on the way by less than `most_rad` (6,), by half of it as a rule.

    It begins and ends where and when it did, and as slowly. Limits of joints are not looked at.
    """
    waves = (WAVES, len(most_rad))
    frequencies_hz, phases_rad = random.uniform(*WANDER_HZ, waves), random.uniform(0, 2 * np.pi, waves)
    angles_rad = 2 * np.pi * frequencies_hz * path.times_s[:, None, None] + phases_rad
    share = np.sin(np.pi * path.times_s / path.lasts_s)[:, None] ** 2
    return Path(path.times_s, path.angles_rad + most_rad * share * np.sin(angles_rad).mean(axis=1))


class Hand:
    """Has hold of an arm from a moment on, and keeps it at the path's end."""

    def __init__(self, path: Path, start_s: float) -> None:
        self._path, self._start_s = path, start_s

    def torques(self, angles: np.ndarray, speeds: np.ndarray, time_s: float) -> np.ndarray:
        """(6,) in N m, for angles and speeds (6,) in radians."""
        wanted = STIFFNESS * (self._path.at(time_s - self._start_s) - angles) - DAMPING * speeds
        return np.clip(wanted, -STRENGTH_NM, STRENGTH_NM)

    def at_end(self, time_s: float) -> bool:
        return time_s - self._start_s >= self._path.lasts_s
