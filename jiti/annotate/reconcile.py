"""What a partition holds, from two files of which either may lag, be missing or be damaged."""

import time
from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.history import Entry, Gap, Header, Scan, entry_line, header_line, scan
from jiti.annotate.segment_file import DamagedFile, FileInfo, Recording, decode, to_segments
from jiti.annotate.segments import Segment
from jiti.annotate.timeline import Timeline, rewound
from jiti.episodes.episode import Problem
from jiti.errors import LabelError, NewerSchema


@dataclass(frozen=True, slots=True)
class Truth:
    """The state that the two files tell together, and what must be done to make them agree."""

    timeline: Timeline
    recording: Recording | None
    history_size: int
    """Bytes of the history that hold acknowledged edits; what follows was being written when a process stopped."""
    problems: tuple[Problem, ...] = ()
    parquet_damaged: bool = False
    """It must be set aside."""
    parquet_lags: bool = False
    """It must be written again."""
    new_history: bytes | None = None
    """What must take the place of a damaged history, which is set aside."""
    recovered: Entry | None = None
    """To append to the history: what only the Parquet file knew."""

    @property
    def needs_repair(self) -> bool:
        return self.parquet_lags or self.new_history is not None or self.recovered is not None


@dataclass(frozen=True, slots=True)
class _Parquet:
    rows: list[Segment] | None
    """None when the file is missing or damaged."""
    info: FileInfo
    error: LabelError | None = None


def reconcile(history: Path, data: bytes, parquet: Path, annotator: str, episode_id: str) -> Truth:
    """Read both files and change neither; `data` is all of the history.

    The newer of the two wins. Raises LabelError when together they do not hold every acknowledged edit,
    NewerSchema when a later jiti wrote one of them.
    """
    found = scan(history, data)
    file = _read(parquet, expect_ours=found.header is not None)
    version = file.info.version or 0
    if found.gap and (file.rows is None or version < found.gap.version):
        raise LabelError(
            f"{history}, line {found.gap.line} is damaged, and {parquet} "
            + (
                f"holds edits up to {version} of {found.gap.version}. "
                if file.rows is not None
                else "cannot stand in. "
            )
            + "Restore one of the two files from a copy; to go on without, move the history away."
        )
    if file.error and not (found.entries or (found.header and found.header.version)):
        raise LabelError(
            f"{file.error}, and the history {history} has nothing to rebuild it from. "
            "Restore the file from a copy; to label the episode again, move it away."
        ) from file.error
    if found.gap:
        return _over_gap(history, parquet, file, found, found.gap, annotator, episode_id)
    if found.header is None:
        return _without_history(history, data, file, episode_id)
    timeline = Timeline(found.header.version, found.header.rows)
    recording = found.header.recording
    for entry in found.entries:
        timeline.append(entry)
        recording = entry.recording or recording
    problems = []
    recovered = None
    if file.error:
        problems.append(
            Problem(str(parquet), str(file.error), "It was rebuilt from the history; the old file is kept.")
        )
    elif file.rows is None and timeline.version:
        problems.append(Problem(str(parquet), "the file was missing", "It was rebuilt from the history."))
    elif file.rows is not None and version < timeline.version:
        problems.append(
            Problem(
                str(parquet),
                f"it held edits up to {version} of {timeline.version}, because a process was stopped in between",
                "It was written again from the history.",
            )
        )
    elif file.rows is not None and version > timeline.version:
        recovered = timeline.recovered_entry(version, file.rows, time.time_ns())
        problems.append(
            Problem(
                str(history),
                f"it held edits up to {timeline.version} of {version}",
                "The rest was taken from the Parquet file; one undo takes it back.",
            )
        )
        timeline.append(recovered)
    return Truth(
        timeline,
        recording,
        found.size,
        tuple(problems),
        parquet_damaged=file.error is not None,
        parquet_lags=bool(problems) and recovered is None,
        recovered=recovered,
    )


def _read(parquet: Path, *, expect_ours: bool) -> _Parquet:
    try:
        table, info = decode(parquet)
        if expect_ours and info.version is None:
            raise DamagedFile(f"{parquet} was replaced by a file that is not jiti's")
        return _Parquet(to_segments(table), info)
    except FileNotFoundError:
        return _Parquet(None, FileInfo())
    except NewerSchema:
        raise
    except DamagedFile as error:
        return _Parquet(None, FileInfo(), error)
    except LabelError as error:
        return _Parquet(None, FileInfo(), DamagedFile(f"{parquet} is damaged: {error}"))
    except OSError as error:
        raise LabelError(f"{parquet} cannot be opened: {(error.strerror or str(error)).lower()}") from error


def _without_history(history: Path, data: bytes, file: _Parquet, episode_id: str) -> Truth:
    """Nothing was acknowledged yet, or the history is lost as a whole."""
    problems = ()
    if data:
        remedy = "No label is lost, but undo starts afresh" if file.rows else "There were no labels yet"
        problems = (Problem(str(history), "none of it can be read", f"{remedy}; the old file is kept."),)
    return Truth(
        Timeline(file.info.version or 0, file.rows or ()),
        file.info.recordings.get(episode_id),
        0,
        problems,
        new_history=b"" if data else None,
    )


def _over_gap(
    history: Path, parquet: Path, file: _Parquet, found: Scan, gap: Gap, annotator: str, episode_id: str
) -> Truth:
    """Start again behind the damaged lines, from rows that the Parquet file gives."""
    version = file.info.version or 0
    rows = rewound(file.rows or (), [entry for entry in found.after_gap if entry.version <= version])
    recording = file.info.recordings.get(episode_id) or (found.header.recording if found.header else None)
    if recording is None:
        raise LabelError(
            f"{history}, line {gap.line} is damaged, and {parquet} does not describe the recording. "
            "Restore the history from a copy, or move it away."
        )
    timeline = Timeline(gap.version, rows)
    lines = [header_line(Header(annotator, episode_id, recording, gap.version, timeline.segments()))]
    for entry in found.after_gap:
        timeline.append(entry)
        lines.append(entry_line(entry))
    if version > timeline.version:
        entry = timeline.recovered_entry(version, file.rows or (), time.time_ns())
        timeline.append(entry)
        lines.append(entry_line(entry))
    problem = Problem(
        str(history),
        f"line {gap.line} is damaged",
        f"No label is lost; undo reaches back to edit {gap.version}. The old file is kept.",
    )
    lags = version < timeline.version
    return Truth(timeline, recording, found.size, (problem,), parquet_lags=lags, new_history=b"".join(lines))
