"""LeRobot v3's table of contents: `meta/episodes/**/*.parquet`, and tasks in `meta/tasks.parquet`."""

import json
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa

from jiti.episodes.episode import Problem
from jiti.episodes.lerobot_entry import EpisodeEntry, VideoPlace, is_index, is_time
from jiti.episodes.lerobot_info import DatasetInfo
from jiti.episodes.lerobot_parquet import damaged, read_columns, to_numpy
from jiti.errors import SourceError

_VIDEO_COLUMNS = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")


class V3Table:
    """Listing reads three columns; where the files are is read when the first episode is opened."""

    place = "meta/episodes"

    def __init__(self, info: DatasetInfo) -> None:
        """Raises SourceError when no file of the table can be read."""
        self.info = info
        self.problems: list[Problem] = []
        folder = info.root / "meta" / "episodes"
        parts, self._files = [], []
        failures: list[SourceError] = []
        for path in sorted(folder.rglob("*.parquet")):
            label = f"{info.name}/{path.relative_to(info.root).as_posix()}"
            try:
                columns = ["episode_index", "length", "tasks"]
                parts.append(read_columns(path, label, columns, columns[:2]))
                self._files.append((path, label))
            except SourceError as error:
                failures.append(error)
        if not parts:
            raise (
                failures[0]
                if failures
                else SourceError(
                    f"{info.name}/{self.place}: there is no episode table (*.parquet) in this folder. "
                    "Download the dataset again; `meta/` must be complete."
                )
            )
        for error in failures:
            self.problems.append(Problem(self.place, str(error), "Its episodes are not listed.", "error"))
        table = _joined(parts, self.place)
        self.numbers = _whole(table, "episode_index", self.place)
        self.lengths = _whole(table, "length", self.place)
        tasks = _listed(table, "tasks", self.place) if "tasks" in table.column_names else [None] * len(self.numbers)
        self.tasks: Sequence[Any] = [[task] if isinstance(task, str) else task for task in tasks]

    def entry(self, at: int) -> EpisodeEntry:
        number, length = int(self.numbers[at]), int(self.lengths[at])
        row = {name: self._places[name][at].as_py() for name in self._places.column_names}
        place = f"{self.info.name}/{self.place}, episode {number}"
        chunk, file = row["data/chunk_index"], row["data/file_index"]
        if not (is_index(chunk) and is_index(file)):
            raise SourceError(f"{place}: does not say in which data file it is. Download the dataset again.")
        videos = {}
        for feature in self.info.features:
            part = [row.get(f"videos/{feature.key}/{name}") for name in _VIDEO_COLUMNS]
            if feature.dtype == "video" and is_index(part[0]) and is_index(part[1]) and is_time(part[2]):
                path = self.info.video_file(feature.key, chunk_index=part[0], file_index=part[1])
                videos[feature.key] = VideoPlace(path, part[2], part[3] if is_time(part[3]) else None)
        first = row.get("dataset_from_index")
        tasks = self.tasks[at]
        return EpisodeEntry(
            number=number,
            length=length,
            tasks=tuple(tasks or ()),
            data_path=self.info.data_file(chunk_index=chunk, file_index=file),
            first_row=first if is_index(first) else None,
            videos=videos,
            problems=tuple(self._overlaps(place, at, videos)),
            text=json.dumps([number, length, tasks, row], default=str),
        )

    @cached_property
    def _places(self) -> pa.Table:
        """Where the parts of the episodes are; no statistics. Rows as in the listing."""
        columns = ["data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index"]
        for feature in self.info.features:
            if feature.dtype == "video":
                columns += [f"videos/{feature.key}/{name}" for name in _VIDEO_COLUMNS]
        return _joined([read_columns(path, label, columns, columns[:2]) for path, label in self._files], self.place)

    def _overlaps(self, place: str, at: int, videos: dict[str, VideoPlace]) -> list[Problem]:
        """Other episodes that claim the same rows or the same pictures."""
        problems = []
        table = self._places
        if {"dataset_from_index", "dataset_to_index"} <= set(table.column_names):
            first, end = (_whole(table, name, place) for name in ("dataset_from_index", "dataset_to_index"))
            if first[at] >= 0:
                others = (first >= 0) & (first < end[at]) & (end > first[at])
                problems += self._overlap(place, at, others, f"rows {first[at]} to {end[at] - 1}")
        for key, video in videos.items():
            chunk, file = (_whole(table, f"videos/{key}/{name}", place) for name in _VIDEO_COLUMNS[:2])
            start = _times(table, f"videos/{key}/from_timestamp")
            end = start + self.lengths / self.info.fps
            # Half a frame: sums of durations differ in their last digits.
            slack = 0.5 / self.info.fps
            others = (chunk == chunk[at]) & (file == file[at]) & (self.lengths > 0)
            others &= (start < end[at] - slack) & (end > start[at] + slack)
            problems += self._overlap(place, at, others, f"the part of {video.path} from {video.start_s:.3f} s")
        return problems

    def _overlap(self, place: str, at: int, others: np.ndarray, what: str) -> list[Problem]:
        others[at] = False
        if not others.any():
            return []
        other = int(self.numbers[np.flatnonzero(others)[0]])
        remedy = "One of the two shows the wrong frames: compare their pictures, then correct meta/episodes."
        return [Problem(place, f"{what} is claimed by episode {other} too", remedy, "error")]


def read_tasks_v3(info: DatasetInfo) -> dict[int, str]:
    """Instructions by `task_index`; the text is in the column `task` or in the index that pandas wrote."""
    label = f"{info.name}/meta/tasks.parquet"
    table = read_columns(info.root / "meta" / "tasks.parquet", label, None, ["task_index"])
    for name in ("task", "__index_level_0__"):
        if name in table.column_names:
            return dict(zip(table["task_index"].to_pylist(), _listed(table, name, label), strict=True))
    raise SourceError(f"{label}: has no column 'task'; it has {', '.join(table.column_names)}. Download it again.")


def _joined(parts: list[pa.Table], place: str) -> pa.Table:
    try:
        return pa.concat_tables(parts, promote_options="permissive")
    except pa.ArrowException as error:
        raise damaged(place, error) from error


def _listed(table: pa.Table, column: str, place: str) -> list[Any]:
    """Texts, or lists of texts, row by row. Raises SourceError for bytes that are no text."""
    try:
        return table[column].to_pylist()
    except ValueError as error:
        raise damaged(place, error) from error


def _whole(table: pa.Table, column: str, place: str) -> np.ndarray:
    """Whole numbers (N,) int64; negative where there is none."""
    try:
        values, valid = to_numpy(_array(table, column).cast(pa.int64(), safe=False))
    except pa.ArrowException as error:
        raise SourceError(f"{place}: column {column!r} does not hold whole numbers ({error}). Correct it.") from error
    return np.where(valid, values, -1)


def _times(table: pa.Table, column: str) -> np.ndarray:
    """Seconds (N,) float64; NaN where there is none."""
    values, valid = to_numpy(_array(table, column).cast(pa.float64(), safe=False))
    return np.where(valid, values, np.nan)


def _array(table: pa.Table, column: str) -> pa.Array:
    chunks = table[column].chunks
    if len(chunks) == 1:
        return chunks[0]
    return pa.concat_arrays(chunks) if chunks else pa.nulls(0, table[column].type)
