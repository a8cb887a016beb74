"""LeRobot v2.1's table of contents: `meta/episodes.jsonl` and `meta/tasks.jsonl`; one file of each kind an episode."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from jiti.episodes.episode import Problem
from jiti.episodes.lerobot_entry import EpisodeEntry, VideoPlace, is_index
from jiti.episodes.lerobot_info import DatasetInfo
from jiti.errors import SourceError


class V2Table:
    """Where the files are follows from the templates in info.json."""

    place = "meta/episodes.jsonl"

    def __init__(self, info: DatasetInfo) -> None:
        """Raises SourceError when the file is missing; a bad line is left out and reported."""
        self.info = info
        self.problems: list[Problem] = []
        numbers, lengths, instructions = [], [], []
        for line, row in _json_lines(info, self.place, self.problems):
            number, length, tasks = row.get("episode_index"), row.get("length"), row.get("tasks")
            if not (is_index(number) and is_index(length)):
                where = f"{info.name}/{self.place}, line {line}"
                self.problems.append(
                    Problem(where, "no episode_index or no length", "The line is left out; correct it.", "error")
                )
                continue
            numbers.append(number)
            lengths.append(length)
            instructions.append([str(task) for task in tasks] if isinstance(tasks, list) else None)
        self.numbers, self.lengths = np.array(numbers, np.int64), np.array(lengths, np.int64)
        self.tasks: Sequence[Sequence[str] | None] = instructions

    def entry(self, at: int) -> EpisodeEntry:
        number, length = int(self.numbers[at]), int(self.lengths[at])
        fields = {"episode_chunk": number // self.info.chunk_size, "episode_index": number}
        tasks = tuple(self.tasks[at] or ())
        return EpisodeEntry(
            number=number,
            length=length,
            tasks=tasks,
            data_path=self.info.data_file(**fields),
            first_row=None,
            videos={
                feature.key: VideoPlace(self.info.video_file(feature.key, **fields), 0.0, None)
                for feature in self.info.features
                if feature.dtype == "video"
            },
            problems=(),
            text=json.dumps([number, length, tasks]),
        )


def read_tasks_v2(info: DatasetInfo) -> dict[int, str]:
    """Instructions by `task_index`."""
    rows = _json_lines(info, "meta/tasks.jsonl", [])
    return {row["task_index"]: str(row["task"]) for _, row in rows if {"task_index", "task"} <= set(row)}


def _json_lines(info: DatasetInfo, place: str, problems: list[Problem]) -> Iterator[tuple[int, dict[str, Any]]]:
    """Objects of a JSON Lines file with their line numbers."""
    label = f"{info.name}/{place}"
    try:
        lines = (info.root / place).read_bytes().splitlines()
    except OSError as error:
        raise SourceError(
            f"{label}: cannot be read ({error.strerror}). Download the dataset again; `meta/` must be complete."
        ) from error
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            row, reason = None, str(error)
        else:
            reason = f"it is a {type(row).__name__}"
        if isinstance(row, dict):
            yield number, row
        else:
            remedy = "The line is left out; correct it."
            problems.append(Problem(f"{label}, line {number}", f"not a JSON object ({reason})", remedy, "error"))
