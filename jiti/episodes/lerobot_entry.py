"""What a LeRobot table of contents says of one episode."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeGuard

import numpy as np

from jiti.episodes.episode import Problem


@dataclass(frozen=True, slots=True)
class VideoPlace:
    """The part of a video file that belongs to an episode; all of the file in v2.1."""

    path: str
    """Inside the dataset."""
    start_s: float
    end_s: float | None
    """None: the end of the file."""


@dataclass(frozen=True, slots=True)
class EpisodeEntry:
    """One episode as the table of contents has it."""

    number: int
    length: int
    tasks: tuple[str, ...]
    data_path: str
    """Inside the dataset."""
    first_row: int | None
    """`index` of its first row in the whole dataset, if recorded."""
    videos: dict[str, VideoPlace]
    """By feature; without those that have no entry."""
    problems: tuple[Problem, ...]
    text: str
    """Everything the table says of it: part of the fingerprint."""


class EpisodeTable(Protocol):
    """The rows of a table of contents, in the order of its files."""

    place: str
    """Inside the dataset, as messages name it."""
    problems: list[Problem]
    numbers: np.ndarray
    """(N,) int64: `episode_index`."""
    lengths: np.ndarray
    """(N,) int64: frames; negative where there is no number."""
    tasks: Sequence[Sequence[str] | None]

    def entry(self, at: int) -> EpisodeEntry:
        """The episode in row `at`. Raises SourceError when it has no place for its data."""
        ...


def join_tasks(tasks: Sequence[str] | None) -> str | None:
    """One instruction of the tasks that an episode lists."""
    return "; ".join(dict.fromkeys(str(task) for task in tasks or () if task)) or None


def is_index(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 53


def is_time(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value) and value >= 0
