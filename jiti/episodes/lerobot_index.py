"""The episodes of a LeRobot dataset by number, whatever its version."""

import re

import numpy as np

from jiti.episodes.episode import EpisodeRef, Problem
from jiti.episodes.lerobot_entry import EpisodeEntry, EpisodeTable, join_tasks
from jiti.episodes.lerobot_info import DatasetInfo
from jiti.episodes.lerobot_v2 import V2Table, read_tasks_v2
from jiti.episodes.lerobot_v3 import V3Table, read_tasks_v3
from jiti.errors import SourceError

_EPISODE_ID = re.compile(r"episode_(\d{6,18})")


def episode_id_of(number: int) -> str:
    return f"episode_{number:06d}"


class EpisodeIndex:
    """Lists episodes in the order of their numbers, each once, and finds one by its id."""

    def __init__(self, info: DatasetInfo) -> None:
        """Raises SourceError when there is no readable table of contents."""
        self.info = info
        table: EpisodeTable = V3Table(info) if info.layout == 3 else V2Table(info)
        self._table = table
        self.problems = list(table.problems)
        where = f"{info.name}/{table.place}"
        if not len(table.numbers) and info.total_episodes:
            raise SourceError(
                f"{where}: lists no episodes; {info.file_name} says {info.total_episodes}. Download the dataset again."
            )
        order = np.argsort(table.numbers, kind="stable")
        repeated = np.flatnonzero(np.diff(table.numbers[order]) == 0) + 1
        if len(repeated):
            what = f"episode {table.numbers[order[repeated[0]]]} is listed twice"
            self.problems.append(Problem(where, what, "The first entry is used; correct the table.", "error"))
            order = np.delete(order, repeated)
        order = order[table.numbers[order] >= 0]
        if info.total_episodes not in (None, len(order)):
            what = f"{len(order)} episodes are listed; info.json says {info.total_episodes}"
            self.problems.append(Problem(where, what, "The list is used; correct total_episodes."))
        self._rows = order
        """Row of the n-th episode in the table."""
        self.numbers = table.numbers[order]

    def refs(self) -> list[EpisodeRef]:
        table = self._table
        refs = []
        for number, length, row in zip(
            self.numbers.tolist(), table.lengths[self._rows].tolist(), self._rows.tolist(), strict=True
        ):
            empty = None if length > 0 else self._empty(number)
            task = join_tasks(table.tasks[row])
            refs.append(EpisodeRef(episode_id_of(number), f"episode {number}", max(length, 0), task, None, empty))
        return refs

    def entry(self, episode_id: str) -> EpisodeEntry:
        """Raises SourceError when there is no such episode, it has no frames, or its data has no place."""
        match = _EPISODE_ID.fullmatch(episode_id)
        number = int(match[1]) if match else -1
        n = int(np.searchsorted(self.numbers, number))
        if n == len(self.numbers) or self.numbers[n] != number or episode_id != episode_id_of(number):
            has = "none"
            if len(self.numbers):
                has = f"{len(self.numbers)}: {episode_id_of(self.numbers[0])} to {episode_id_of(self.numbers[-1])}"
            raise SourceError(f"{self.info.name} has no episode {episode_id!r}; it has {has}.")
        row = int(self._rows[n])
        if self._table.lengths[row] <= 0:
            raise SourceError(str(self._empty(number)))
        return self._table.entry(row)

    def tasks(self) -> dict[int, str]:
        """Instructions by `task_index`. Raises SourceError when their file cannot be read."""
        return read_tasks_v3(self.info) if self.info.layout == 3 else read_tasks_v2(self.info)

    def _empty(self, number: int) -> Problem:
        where = f"{self.info.name}/{self._table.place}, episode {number}"
        return Problem(where, "the episode has no frames", "Leave it out, or record it again.", "error")
