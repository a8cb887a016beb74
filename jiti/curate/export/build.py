"""Write a planned dataset: piece by piece beside its place, then all of it at once under its name."""

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from jiti.curate.export.features import Shape
from jiti.curate.export.frames import frames_of
from jiti.curate.export.journal import Done, Journal
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
from jiti.curate.export.plan import Plan, PlannedEpisode, Progress
from jiti.curate.export.rows import data_schema, episode_columns, to_table
from jiti.curate.export.shards import DATA_FILE_BYTES, VIDEO_FILE_BYTES, Joiner, Places, join_tables
from jiti.curate.export.sources import Source
from jiti.curate.export.stats import Stats, column_stats, merged
from jiti.durable import sync, sync_folder
from jiti.errors import JitiError, SaveFailed
from jiti.tasks.task import Task


@dataclass(frozen=True, slots=True)
class Output:
    """Where and how a dataset is written."""

    root: Path
    gamma: float
    about: Mapping[str, Any]
    """For `meta/jiti/curate.json`."""
    card: str
    """README.md."""
    overwrite: bool = False


def build(plan: Plan, sources: Sequence[Source], output: Output, progress: Progress = lambda _s, _w: None) -> list[str]:
    """Write it; gives what a person should know. What a stopped run with the same inputs has finished is taken over.

    Raises SaveFailed when the disk refuses, SourceError for what is wrong in a recording; in both cases nothing is at
    `output.root` that was not there before.
    """
    partial = output.root.with_name(f".{output.root.name}.partial")
    by_name = {source.name: source for source in sources}
    notes: list[str] = []
    with _explained(partial, output.root):
        journal = Journal.open(partial, plan.digest)
        writer = _Writer(plan, journal, output)
        for number, planned in enumerate(plan.episodes):
            progress(number / len(plan.episodes), f"{planned.source}, {planned.title}")
            done = journal.done(number) or journal.add(writer.piece(planned, by_name[planned.source]))
            writer.place(planned, done)
            notes += done.notes
        progress(1.0, "writing tables")
        writer.finish()
        _put(partial, journal.dataset, output)
    return notes


class _Writer:
    def __init__(self, plan: Plan, journal: Journal, output: Output) -> None:
        self._plan, self._journal, self._output = plan, journal, output
        self._schema = data_schema(plan.shapes)
        self._task_index = {text: number for number, text in enumerate(plan.instructions)}
        self._data = Joiner(journal.dataset, DATA_PATH, DATA_FILE_BYTES, join_tables)

    def piece(self, planned: PlannedEpisode, source: Source) -> Done:
        """Make one episode's files."""
        title = f"{planned.source}, {planned.title}"
        episode = source.reader.open(planned.episode_id)
        frames = frames_of(episode.clock, self._plan.fps if self._plan.resampled else None)
        task: Task | None = source.catalogue.task(planned.task_id) if planned.task_id else None
        numbers = read_numbers(planned.features, episode, frames, task, title)
        task_index = self._task_index[planned.instruction]
        columns = episode_columns(planned, numbers, self._plan.fps, self._output.gamma, task_index)
        path = self._journal.piece(planned.index, "data.parquet")
        pq.write_table(to_table(columns, self._schema), path, compression="snappy", use_dictionary=True)
        stats: dict[str, Stats] = {key: column_stats(values) for key, values in columns.items()}
        return Done(planned.index, path.stat().st_size, {}, stats, ())

    def place(self, planned: PlannedEpisode, done: Done) -> None:
        """Give a finished piece to the files."""
        self._data.add(self._journal.piece(planned.index, "data.parquet"), done.data_bytes, planned.frames)

    def finish(self) -> None:
        """Write what is left and all that stands beside it."""
        self._data.close()
        root, plan = self._journal.dataset, self._plan
        (root / "meta").mkdir(exist_ok=True)
        total: dict[str, Stats] | None = None
        for done in self._journal.all():
            total = merged(total, done.stats)
        write_info(root, plan, {}, None)
        write_tasks(root, plan)
        write_stats(root, total or {})
        write_episode_table(root, plan, self._rows())
        write_own(root, plan, self._output.about)
        write_labels(root, plan)
        (root / "README.md").write_text(self._output.card)

    def _rows(self) -> Iterator[tuple[PlannedEpisode, Mapping[str, Any], Mapping[str, Stats]]]:
        data = Places(DATA_FILE_BYTES)
        for planned, done in zip(self._plan.episodes, self._journal.all(), strict=True):
            where = data_columns(data.next(done.data_bytes, planned.frames), planned)
            yield planned, where, done.stats


def _put(partial: Path, dataset: Path, output: Output) -> None:
    """Give the finished dataset its name, durably."""
    for folder, _, files in os.walk(dataset):
        for name in files:
            descriptor = os.open(Path(folder, name), os.O_RDONLY | os.O_CLOEXEC)
            try:
                sync(descriptor)
            finally:
                os.close(descriptor)
        sync_folder(Path(folder))
    if output.root.exists():
        old = partial / "replaced"
        output.root.rename(old)
    dataset.rename(output.root)
    sync_folder(output.root.parent)
    shutil.rmtree(partial)


@contextmanager
def _explained(partial: Path, root: Path) -> Iterator[None]:
    try:
        yield
    except SaveFailed as error:
        raise _refused(partial, root, error.__cause__ if isinstance(error.__cause__, OSError) else error) from error
    except JitiError:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    except OSError as error:
        raise _refused(partial, root, error) from error


def _refused(partial: Path, root: Path, error: BaseException) -> SaveFailed:
    number = getattr(error, "errno", None)
    reason = (os.strerror(number) if number else str(error)).lower()
    return SaveFailed(
        f"{root} could not be written: {reason}. Nothing is there that was not there before; finished episodes are kept "
        f"in {partial}. Make room and run the same command, which goes on there, or remove that folder."
    )


__all__ = ["VIDEO_FILE_BYTES", "VIDEO_PATH", "Shape", "json", "video_columns"]
