"""LeRobot datasets, v3.0 and (read-only) v2.1, as episodes; read with pyarrow and PyAV alone."""

import hashlib
import heapq
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import av
import numpy as np

from jiti.episodes.clock import Clock
from jiti.episodes.episode import Batch, EpisodeRef, NumericBatch, Problem, Stream
from jiti.episodes.lerobot_check import check_rows
from jiti.episodes.lerobot_entry import EpisodeEntry, VideoPlace, join_tasks
from jiti.episodes.lerobot_index import EpisodeIndex, episode_id_of
from jiti.episodes.lerobot_info import INDEX_COLUMNS, DatasetInfo, Feature, load_info
from jiti.episodes.lerobot_pictures import ColumnPictures, Pictures, VideoPictures
from jiti.episodes.lerobot_rows import EpisodeRows, is_numeric, to_floats
from jiti.episodes.video_clip import Clip
from jiti.errors import SourceError

ROWS_AT_ONCE = 4096
"""Rows of numbers that are held at a time. Our choice: two minutes at 30 Hz, a megabyte for 34 numbers."""


class LeRobotReader:
    """The episodes of a dataset folder; listing reads the table of contents only."""

    def __init__(self, root: Path, *, title: str | None = None, labels_dir: str | None = None) -> None:
        """`title` is what messages call the dataset (default: the folder's name); `labels_dir` defaults to
        `<root>/meta/jiti`. Raises SourceError when `meta/` cannot be read.
        """
        root = root.absolute()
        self.info = load_info(root, title)
        self._index = EpisodeIndex(self.info)
        self.title = f"{len(self._index.numbers)} episodes in {self.info.name}"
        self.labels_dir = labels_dir or str(root / "meta" / "jiti")
        self.problems: Sequence[Problem] = self._index.problems

    @cached_property
    def _refs(self) -> list[EpisodeRef]:
        return self._index.refs()

    def episodes(self) -> Sequence[EpisodeRef]:
        return self._refs

    def open(self, episode_id: str) -> "LeRobotEpisode":
        entry = self._index.entry(episode_id)
        return LeRobotEpisode(self.info, entry, join_tasks(entry.tasks), self._tasks)

    def fingerprint(self, episode_id: str) -> str:
        """That of the episode, without opening its files. Raises SourceError when there is none of that id."""
        return _fingerprint(self.info, self._index.entry(episode_id))

    @cached_property
    def _tasks(self) -> Mapping[int, str]:
        """Instructions by number, for episodes whose entry names none; empty when they cannot be read."""
        try:
            return self._index.tasks()
        except SourceError:
            return {}


class LeRobotEpisode:
    """One episode: numbers from its rows, cameras from videos or from a column. Not thread-safe while opening."""

    def __init__(self, info: DatasetInfo, entry: EpisodeEntry, task: str | None, tasks: Mapping[int, str]) -> None:
        """Raises SourceError when neither its rows nor any of its videos can be read."""
        self._info, self._entry = info, entry
        self.episode_id = episode_id_of(entry.number)
        self._problems = list(entry.problems)
        self.problems: Sequence[Problem] = self._problems
        self.fingerprint = _fingerprint(info, entry)
        first_error: SourceError | None = None
        self._rows: EpisodeRows | None = None
        try:
            rows = EpisodeRows(info.root / entry.data_path, f"{info.name}/{entry.data_path}", entry.number)
            self._problems += check_rows(rows, entry.number, entry.length, entry.first_row, info.fps)
            self._rows = rows
        except SourceError as error:
            first_error = error
            self._problems.append(_as_problem(error, "Only the videos of this episode are shown."))
        self.task_id: str | None = None
        self.task = task or self._task_of_rows(tasks)
        count = self._rows.count if self._rows else entry.length
        self._pictures: dict[str, Pictures] = {}
        self.streams: Mapping[str, Stream] = dict(self._open_streams(count))
        if first_error is not None and not self._pictures:
            raise first_error
        frame_ns = np.rint(np.arange(count) * (1e9 / info.fps)).astype(np.int64)
        self.clock = Clock(self._reference(), frame_ns)
        self.image_bytes = sum(pictures.max_bytes for pictures in self._pictures.values())

    def read(self, streams: Sequence[str] | None = None) -> Iterator[Batch]:
        wanted = [s.name for s in self.streams.values() if s.kind != "other"] if streams is None else list(streams)
        for name in wanted:
            if name not in self.streams:
                raise SourceError(f"{self.episode_id} has no stream {name!r}; it has: {', '.join(self.streams)}.")
        sources: list[Iterator[Batch]] = [
            pictures.read(self.clock.frame_ns, self._report)
            for name, pictures in self._pictures.items()
            if name in wanted
        ]
        numeric = [name for name in wanted if self.streams[name].kind == "numeric"]
        if numeric:
            sources.append(self._numbers(numeric))
        return heapq.merge(*sources, key=lambda batch: int(batch.time_ns[0]))

    def decode(self, stream: str, frames: Sequence[int]) -> Iterator[tuple[int, av.VideoFrame]] | None:
        """Pictures straight from the video file; None for cameras without one."""
        return self._pictures[stream].decode(list(frames))

    def clip(self, stream: str) -> Clip | None:
        """The part of a video file that holds a camera's pictures as they are shown; None where none does."""
        pictures = self._pictures.get(stream)
        return pictures.clip if isinstance(pictures, VideoPictures) and pictures.stream.kind == "camera" else None

    def _numbers(self, names: list[str]) -> Iterator[NumericBatch]:
        if self._rows is None:
            return
        for first, batch in self._rows.batches(names, ROWS_AT_ONCE):
            time_ns = self.clock.frame_ns[first : first + batch.num_rows]
            for name in names:
                values = to_floats(batch.column(name), self.streams[name].shape[0])
                yield NumericBatch(name, time_ns, values)

    def _open_streams(self, count: int) -> Iterator[tuple[str, Stream]]:
        for feature in self._info.features:
            if feature.dtype in ("video", "image"):
                pictures = self._open_pictures(feature, count)
                if pictures is not None:
                    self._pictures[feature.key] = pictures
                    yield feature.key, pictures.stream
            elif feature.key not in INDEX_COLUMNS and self._rows is not None:
                stream = self._row_stream(feature, self._rows)
                if stream is not None:
                    yield feature.key, stream

    def _open_pictures(self, feature: Feature, count: int) -> Pictures | None:
        try:
            if feature.dtype == "video":
                return self._open_video(feature, count)
            return ColumnPictures(feature, self._rows, self._info) if self._rows else None
        except SourceError as error:
            self._report(_as_problem(error, f"{feature.key} is not shown; the other streams are."))
            return None

    def _open_video(self, feature: Feature, count: int) -> VideoPictures:
        place = self._entry.videos.get(feature.key)
        if place is None:
            raise SourceError(
                f"{self._info.name}/meta/episodes, episode {self._entry.number}: does not say where the video of "
                f"{feature.key!r} is. Download the dataset again."
            )
        label = f"{self._info.name}/{place.path}"
        clip = Clip(self._info.root / place.path, label, place.start_s, self._info.fps, count)
        pictures = VideoPictures(feature, clip)
        for problem in pictures.scan.problems:
            self._report(problem)
        if len(pictures.scan.frames) == count:
            self._check_length(label, place, pictures.scan.file_frames, count)
        return pictures

    def _check_length(self, label: str, place: VideoPlace, file_frames: int, count: int) -> None:
        """Report a video that goes on after the last row."""
        if self._info.layout == 2:
            there = file_frames
        elif place.end_s is not None:
            # Some writers give the time of the last frame, others its end: one frame more or less says nothing.
            there = round((place.end_s - place.start_s) * self._info.fps)
            there = count if abs(there - count) <= 1 else there
        else:
            return
        if there > count:
            what = f"the video has {there} frames for episode {self._entry.number}, the episode has {count} rows"
            remedy = "The last frames of the video are not shown; check that the first ones belong to the first rows."
            self._report(Problem(label, what, remedy))

    def _row_stream(self, feature: Feature, rows: EpisodeRows) -> Stream | None:
        if feature.key not in rows.schema.names:
            what = f"there is no column {feature.key!r}, which info.json lists"
            self._report(Problem(rows.label, what, "The other streams are shown; download the dataset again.", "error"))
            return None
        rate_hz = self._info.fps if rows.count > 1 else None
        numeric = is_numeric(rows.schema.field(feature.key).type)
        return Stream(
            feature.key,
            "numeric" if numeric else "other",
            rows.count,
            rate_hz,
            (feature.size,) if numeric else (),
            feature.dtype,
            names=feature.names if numeric else (),
        )

    def _task_of_rows(self, tasks: Mapping[int, str]) -> str | None:
        if self._rows is None or "task_index" not in self._rows.index:
            return None
        numbers = dict.fromkeys(self._rows.index["task_index"].tolist())
        return join_tasks([tasks[number] for number in numbers if number in tasks])

    def _reference(self) -> str | None:
        """The first camera that has pictures, else the first depth; None: the rate of info.json alone."""
        for kind in ("camera", "depth"):
            for name, pictures in self._pictures.items():
                if pictures.stream.kind == kind and pictures.stream.count:
                    return name
        return None

    def _report(self, problem: Problem) -> None:
        if problem not in self._problems:
            self._problems.append(problem)


def _fingerprint(info: DatasetInfo, entry: EpisodeEntry) -> str:
    """Of info.json, the episode's entry, and the sizes of its files."""
    digest = hashlib.sha256(info.text)
    digest.update(entry.text.encode())
    for path in sorted({entry.data_path, *(video.path for video in entry.videos.values())}):
        try:
            size = (info.root / path).stat().st_size
        except OSError:
            size = -1
        digest.update(f"\n{path} {size}".encode())
    return digest.hexdigest()[:32]


def _as_problem(error: SourceError, remedy: str) -> Problem:
    where, _, what = str(error).partition(": ")
    return Problem(where, what.rstrip("."), remedy, "error")
