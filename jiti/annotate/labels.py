"""All labels of a source at once: every annotator's and every machine's segments in one table.

Ten thousand episodes are ten thousand small files. They are read by several threads, and what was read is kept in the
user's cache folder, so that the next time only files that changed are opened.
"""

import os
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from jiti.annotate import labels_cache
from jiti.annotate.folder import annotator_dirs
from jiti.annotate.labels_cache import RECORDINGS, RECORDINGS_IN_FILE, ROWS, FileKey, Kept
from jiti.annotate.segment_file import FileInfo, Recording, decode
from jiti.episodes.episode import Problem
from jiti.errors import LabelError, NewerSchema

_THREADS = 2
"""Our choice: half of the time to read a small file is spent in Python; more threads wait for each other."""
_BATCH = 250
"""Files whose rows are joined as soon as they are read. Measured: to keep 11,000 small tables at once costs 1 s."""


@dataclass(frozen=True, slots=True)
class Labels:
    """What the files of a labels folder hold together."""

    segments: pa.Table
    """The columns of a segment and `annotator`; by annotator, then file, then as in the file."""
    recordings: pa.Table
    """annotator, episode_id, frame_count, frame_rate_hz, fingerprint: one row for each episode in each file.

    Also for files without a segment: someone began to label that episode.
    """
    problems: tuple[Problem, ...] = ()
    """Files that could not be read, which are left out."""

    def whole(self) -> "Labels":
        """These labels, where no file was left out. Raises LabelError, which names those that were."""
        if self.problems:
            raise LabelError("; ".join(map(str, self.problems[:3])))
        return self

    def by_episode(self) -> dict[str, Recording]:
        """What is known of each recording; where annotators labelled different ones, the longest."""
        rows = zip(*(self.recordings[name].to_pylist() for name in RECORDINGS.names[1:]), strict=True)
        found: dict[str, Recording] = {}
        for episode_id, frame_count, frame_rate_hz, fingerprint in rows:
            if episode_id not in found or found[episode_id].frame_count < frame_count:
                found[episode_id] = Recording(frame_count, frame_rate_hz, fingerprint)
        return found


def read_segments(
    labels_dir: Path, *, annotators: Collection[str] | None = None, episodes: Collection[str] | None = None
) -> pa.Table:
    """The segments of `read_labels`, where a file that cannot be read is an error. Raises LabelError."""
    return read_labels(labels_dir, annotators=annotators, episodes=episodes).whole().segments


def read_labels(
    labels_dir: Path,
    *,
    annotators: Collection[str] | None = None,
    episodes: Collection[str] | None = None,
    cache_dir: Path | None = None,
    skip_newer: bool = False,
) -> Labels:
    """Everything that was labelled, or what some annotators labelled, or that of some episodes.

    A folder that is not there has no labels. Files that cannot be read are left out and named in `problems`.
    Raises NewerSchema when a later jiti wrote one; with `skip_newer`, as lists of episodes want it, that is one of
    `problems` too.
    """
    files = list(_list(labels_dir, annotators))
    cache = labels_cache.path_for(labels_dir, cache_dir)
    kept = labels_cache.load(cache) if len(files) >= labels_cache.WORTH_FILES else Kept.nothing()

    known = [kept.index.get(key, -1) for _, _, key in files]
    unread = [position for position, index in enumerate(known) if index < 0]
    fresh = _read_all([(position, files[position][1]) for position in unread], skip_newer=skip_newer)
    all_rows = _joined(_moved(kept.rows, known), fresh.rows)
    all_recordings = _joined(_moved(kept.recordings, known), fresh.recordings)
    if annotators is None and len(files) >= labels_cache.WORTH_FILES and len(unread) >= labels_cache.WORTH_CHANGES:
        failed = set(unread) - set(fresh.positions)
        keys = ["" if position in failed else key for position, (_, _, key) in enumerate(files)]
        labels_cache.save(cache, keys, all_rows, all_recordings)

    names = pa.array([annotator for annotator, _, _ in files], pa.string())
    segments = all_rows.drop_columns("file").append_column("annotator", names.take(all_rows["file"]))
    about = all_recordings.drop_columns("file").add_column(0, "annotator", names.take(all_recordings["file"]))
    if episodes is not None:
        segments, about = (
            t.filter(pa.array(np.isin(t["episode_id"].to_numpy(), [*episodes]))) for t in (segments, about)
        )
    return Labels(segments, about.cast(RECORDINGS), fresh.problems)


def _list(labels_dir: Path, annotators: Collection[str] | None) -> Iterator[tuple[str, str, FileKey]]:
    """Annotator, path and what tells a changed file, in a stable order."""
    for annotator, folder in annotator_dirs(labels_dir):
        if annotators is None or annotator in annotators:
            with os.scandir(folder) as entries:
                found = [e for e in entries if e.name.endswith(".parquet") and not e.name.startswith((".", "_"))]
            for entry in sorted(found, key=lambda entry: entry.name):
                try:
                    status = entry.stat()
                except FileNotFoundError:
                    continue  # removed since it was listed, or a link that leads nowhere
                key = f"{annotator}/{entry.name} {status.st_size} {status.st_mtime_ns} {status.st_ino}"
                yield annotator, entry.path, key


@dataclass(frozen=True, slots=True)
class _Read:
    """What some of the files hold; `file` is a file's position in the list of all."""

    positions: tuple[int, ...]
    rows: pa.Table
    recordings: pa.Table
    problems: tuple[Problem, ...]


def _read_all(files: list[tuple[int, str]], *, skip_newer: bool) -> _Read:
    """Rows and recordings of files, given by position and path, in their order; and those that cannot be read."""

    # A slice for each thread, not a task for each file: handing over a task costs as much as reading a file.
    def read_slice(first: int) -> list[_Read]:
        mine = files[first::_THREADS]
        return [_read_batch(mine[start : start + _BATCH], skip_newer) for start in range(0, len(mine), _BATCH)]

    with ThreadPoolExecutor(_THREADS) as pool:
        parts = [part for slices in pool.map(read_slice, range(_THREADS)) for part in slices]
    rows = _joined(*(part.rows for part in parts)) if parts else ROWS.empty_table()
    recordings = _joined(*(part.recordings for part in parts)) if parts else RECORDINGS_IN_FILE.empty_table()
    problems = sorted((problem for part in parts for problem in part.problems), key=lambda problem: problem.where)
    return _Read(tuple(p for part in parts for p in part.positions), rows, recordings, tuple(problems))


def _read_batch(files: list[tuple[int, str]], skip_newer: bool) -> _Read:
    read: list[tuple[int, pa.Table, FileInfo]] = []
    problems: list[Problem] = []
    for position, path in files:
        try:
            read.append((position, *decode(Path(path))))
        except FileNotFoundError:
            continue  # removed since it was listed
        except NewerSchema as error:
            if not skip_newer:
                raise
            problems.append(Problem(path, str(error), "It is left out here.", "error"))
        except (LabelError, OSError) as error:
            remedy = "It is left out; open the episode in `jiti annotate`, which rebuilds the file from its history."
            problems.append(Problem(path, str(error), remedy, "error"))
    return _Read(tuple(position for position, _, _ in read), _rows(read), _recordings(read), tuple(problems))


def _moved(table: pa.Table, known: list[int]) -> pa.Table:
    """Cached rows of the files that are still there, under their place among today's files."""
    place = np.full(max([*known, *table["file"].to_numpy()[-1:]], default=0) + 2, -1, np.int64)
    place[known] = np.arange(len(known))
    place[-1] = -1  # where files that are not cached went
    position = place[table["file"].to_numpy()]
    table = table.set_column(table.schema.get_field_index("file"), "file", pa.array(position))
    return table if (position >= 0).all() else table.filter(pa.array(position >= 0))


def _rows(fresh: list[tuple[int, pa.Table, FileInfo]]) -> pa.Table:
    if not fresh:
        return ROWS.empty_table()
    table = pa.concat_tables([table for _, table, _ in fresh]).combine_chunks()
    position = np.repeat([position for position, _, _ in fresh], [len(table) for _, table, _ in fresh])
    return table.append_column("file", pa.array(position, pa.int64()))


def _recordings(fresh: list[tuple[int, pa.Table, FileInfo]]) -> pa.Table:
    rows = [
        (episode_id, about.frame_count, about.frame_rate_hz, about.fingerprint, position)
        for position, _, info in fresh
        for episode_id, about in info.recordings.items()
    ]
    columns = zip(*rows, strict=True) if rows else [()] * len(RECORDINGS_IN_FILE)
    return pa.table(list(columns), schema=RECORDINGS_IN_FILE)


def _joined(*tables: pa.Table) -> pa.Table:
    """All of them, in the order of files."""
    table = pa.concat_tables(tables).combine_chunks()
    position = table["file"].to_numpy()
    if (np.diff(position) >= 0).all():
        return table
    return table.take(pa.array(np.argsort(position, kind="stable")))
