"""Write a planned dataset: piece by piece beside its place, then all of it at once under its name."""

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from jiti.curate.export.codec import Codec
from jiti.curate.export.features import DERIVED, INDEX
from jiti.curate.export.frames import Frames, frames_of
from jiti.curate.export.journal import Done, DoneVideo, Journal
from jiti.curate.export.meta import (
    DATA_PATH,
    VIDEO_PATH,
    data_columns,
    video_columns,
    write_episode_table,
    write_info,
    write_labels,
    write_own,
    write_stats,
    write_tasks,
)
from jiti.curate.export.numbers import read_numbers
from jiti.curate.export.plan import Plan
from jiti.curate.export.planned import PlannedEpisode
from jiti.curate.export.remux import join_videos
from jiti.curate.export.rows import data_schema, episode_columns, frame_labels, to_table
from jiti.curate.export.shards import DATA_FILE_BYTES, VIDEO_FILE_BYTES, Joiner, Places, join_tables
from jiti.curate.export.sources import Source
from jiti.curate.export.stats import Stats, column_stats, merged
from jiti.curate.export.videos import Camera, make_video
from jiti.curate.export.weights import WEIGHTS_FILE, label_progress, write_weights
from jiti.durable import sync_file, sync_folder
from jiti.episodes.episode import Episode
from jiti.errors import SaveFailed, SourceError
from jiti.progress import Progress


@dataclass(frozen=True, slots=True)
class Output:
    """Where and how a dataset is written."""

    root: Path
    gamma: float
    about: Mapping[str, Any]
    """For `meta/jiti/curate.json`."""
    card: str
    """README.md."""
    codec: Codec | None = None
    """None to copy videos where that can be, and else h264."""
    robot: str | None = None
    weights: bool = False
    """Whether weights for `lerobot-train` are written beside it."""


def build(plan: Plan, sources: Sequence[Source], output: Output, progress: Progress = lambda _s, _w: None) -> list[str]:
    """Write it; gives what a person should know. What a stopped run with the same inputs has finished is taken over.

    Raises SaveFailed when the disk refuses, SourceError for what is wrong in a recording; in both cases nothing is at
    `output.root` that was not there before.
    """
    unfinished = output.root.with_name(f".{output.root.name}.partial")
    by_name = {source.name: source for source in sources}
    notes: list[str] = []
    with _explained(unfinished, output.root), closing(Journal.open(unfinished, plan.digest)) as journal:
        if journal.finished:
            notes.append(f"{journal.finished} of {len(plan.episodes)} episodes were there from a run that was stopped.")
        writer = _Writer(plan, journal, output)
        with _told(journal, plan):
            for number, planned in enumerate(plan.episodes):
                progress(number / len(plan.episodes), f"{planned.source}, {planned.title}")
                done = journal.done(number) or journal.add(writer.piece(planned, by_name[planned.source]))
                writer.place(planned, done)
                notes += done.notes
            progress(1.0, "writing tables")
            writer.finish()
        _put(unfinished, journal.dataset, output)
    return notes


class _Writer:
    def __init__(self, plan: Plan, journal: Journal, output: Output) -> None:
        self._plan, self._journal, self._output = plan, journal, output
        self._schema = data_schema(plan.shapes)
        self._task_index = {text: number for number, text in enumerate(plan.instructions)}
        self._data = Joiner(journal.dataset, DATA_PATH, DATA_FILE_BYTES, join_tables)
        join = partial(join_videos, fps=plan.fps)
        self._videos = {key: Joiner(journal.dataset, _path_of(key), VIDEO_FILE_BYTES, join) for key in _cameras(plan)}

    def piece(self, planned: PlannedEpisode, source: Source) -> Done:
        """Make one episode's files."""
        title = f"{planned.source}, {planned.title}"
        episode = source.reader.open(planned.episode_id)
        frames = frames_of(episode.clock, self._plan.fps if self._plan.resampled else None)
        numbers = read_numbers(planned.features, episode, frames, planned.task, title)
        task_index = self._task_index[planned.instruction]
        columns = episode_columns(planned, numbers, self._plan.fps, self._output.gamma, task_index)
        path = self._journal.piece(planned.index, "data.parquet")
        pq.write_table(to_table(columns, self._schema), path, compression="snappy", use_dictionary=True)
        made = self._make_videos(planned, episode, frames, title)
        stats: dict[str, Stats] = {}
        for key in (*self._plan.shapes, *DERIVED, *INDEX):
            stats[key] = made[key][1] if key in made else column_stats(columns[key])
        videos = {key: video for key, (video, _, _) in made.items()}
        notes = tuple(note for _, _, note in made.values() if note)
        return Done(planned.index, path.stat().st_size, videos, stats, notes)

    def place(self, planned: PlannedEpisode, done: Done) -> None:
        """Give a finished piece to the files."""
        self._data.add(self._journal.piece(planned.index, "data.parquet"), done.data_bytes, planned.frames)
        for key, video in done.videos.items():
            self._videos[key].add(self._video(planned, key), video.size_bytes, planned.frames, video.kind)

    def _video(self, planned: PlannedEpisode, key: str) -> Path:
        return self._journal.piece(planned.index, f"{key}.mp4")

    def _make_videos(
        self, planned: PlannedEpisode, episode: Episode, frames: Frames, title: str
    ) -> dict[str, tuple[DoneVideo, Stats, str]]:
        """All cameras at once, a thread each: encoders and decoders leave Python alone."""
        wanted = [
            Camera(one.key, one.camera, self._plan.shapes[one.key].shape[:2], self._video(planned, one.key))
            for one in planned.features
            if one.camera is not None
        ]
        if not wanted:
            return {}
        with ThreadPoolExecutor(len(wanted), thread_name_prefix="encode") as pool:
            make = partial(make_video, episode, frames, self._plan.fps, self._output.codec, title)
            return {camera.key: made for camera, made in zip(wanted, pool.map(make, wanted), strict=True)}

    def finish(self) -> None:
        """Write what is left and all that stands beside it."""
        for joiner in (self._data, *self._videos.values()):
            joiner.close()
        root, plan = self._journal.dataset, self._plan
        (root / "meta").mkdir(exist_ok=True)
        total: dict[str, Stats] | None = None
        described: dict[str, Mapping[str, Any]] = {}
        for done in self._journal.all():
            total = merged(total, done.stats)
            for key, video in done.videos.items():
                described.setdefault(key, video.info)
        write_info(root, plan, described, self._output.robot)
        write_tasks(root, plan)
        write_stats(root, total or {})
        write_episode_table(root, plan, self._rows())
        write_own(root, plan, self._output.about)
        write_labels(root, plan)
        if self._output.weights:
            write_weights(root / WEIGHTS_FILE, ((p.index, label_progress(*frame_labels(p))) for p in plan.episodes))
        (root / "README.md").write_text(self._output.card)

    def _rows(self) -> Iterator[tuple[PlannedEpisode, Mapping[str, Any], Mapping[str, Stats]]]:
        data = Places(DATA_FILE_BYTES)
        files = {key: Places(VIDEO_FILE_BYTES) for key in _cameras(self._plan)}
        for planned, done in zip(self._plan.episodes, self._journal.all(), strict=True):
            where = data_columns(data.next(done.data_bytes, planned.frames), planned)
            for key, video in done.videos.items():
                place = files[key].next(video.size_bytes, planned.frames, video.kind)
                where |= video_columns(key, place, planned.frames, self._plan.fps)
            yield planned, where, done.stats


def _cameras(plan: Plan) -> list[str]:
    return [key for key, shape in plan.shapes.items() if shape.dtype == "video"]


def _path_of(key: str) -> str:
    return VIDEO_PATH.replace("{video_key}", key)


def _put(unfinished: Path, dataset: Path, output: Output) -> None:
    """Give the finished dataset its name, durably."""
    for folder, _, files in os.walk(dataset):
        for name in files:
            sync_file(Path(folder, name))
        sync_folder(Path(folder))
    if output.root.exists():
        old = unfinished / "replaced"
        output.root.rename(old)
    dataset.rename(output.root)
    sync_folder(output.root.parent)
    shutil.rmtree(unfinished)


@contextmanager
def _explained(unfinished: Path, root: Path) -> Iterator[None]:
    try:
        yield
    except SaveFailed as error:
        raise _refused(unfinished, root, error.__cause__ if isinstance(error.__cause__, OSError) else error) from error
    except SourceError:
        # Another input is needed, with which nothing of this could be used.
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    except OSError as error:
        raise _refused(unfinished, root, error) from error


@contextmanager
def _told(journal: Journal, plan: Plan) -> Iterator[None]:
    """An interrupt says what is kept."""
    try:
        yield
    except KeyboardInterrupt as error:
        if not journal.finished:
            raise KeyboardInterrupt("No episode was finished.") from error
        kept = f"{journal.finished} of {len(plan.episodes)} episodes are finished and kept"
        raise KeyboardInterrupt(f"{kept}; the same command goes on there.") from error


def _refused(unfinished: Path, root: Path, error: BaseException) -> SaveFailed:
    number = getattr(error, "errno", None)
    reason = (os.strerror(number) if number else str(error)).lower()
    return SaveFailed(
        f"{root} could not be written: {reason}. Nothing is there that was not there before; finished episodes are "
        f"kept in {unfinished}. Make room and run the same command, which goes on there, or remove that folder."
    )
