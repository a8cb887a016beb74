"""The history of a partition: one line an edit, appended and never changed, enough to rebuild the labels from.

A file is JSON lines, each closed by a checksum of itself. The first line says what the history is about and
from which rows it starts; every other line is an `Entry`, whose version is one more than the one before.
"""

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from jiti.annotate.segment_file import Recording, check_schema_version, recording_from
from jiti.annotate.segments import SCHEMA_VERSION, Segment
from jiti.errors import LabelError

Kind = Literal["edit", "undo", "redo", "recording", "recovered"]

_SEAL = b',"crc32":"'


@dataclass(frozen=True, slots=True)
class Entry:
    """One acknowledged change. `before` leave the partition, then `after` enter it."""

    version: int
    at: int
    """Nanoseconds since 1970, UTC."""
    kind: Kind
    """`recording` confirms what is labelled and touches no row; `recovered` was in the Parquet file only."""
    action: str
    """What the annotator did, in a word: `mark`, `nudge`, `accept`."""
    before: tuple[Segment, ...]
    after: tuple[Segment, ...]
    of: int | None = None
    """The version that an undo or redo is about."""
    recording: Recording | None = None
    """Set when, and only when, `kind == "recording"`."""

    def to_json(self) -> dict[str, Any]:
        """As in the file and in `StaleWrite.changes`."""
        return {
            "version": self.version,
            "at": self.at,
            "kind": self.kind,
            "action": self.action,
            "before": [segment.to_row() for segment in self.before],
            "after": [segment.to_row() for segment in self.after],
            **({} if self.of is None else {"of": self.of}),
            **({} if self.recording is None else {"recording": asdict(self.recording)}),
        }


@dataclass(frozen=True, slots=True)
class Header:
    """The first line: whose history this is, and the rows that it starts from."""

    annotator: str
    episode_id: str
    recording: Recording
    version: int = 0
    rows: tuple[Segment, ...] = ()
    """Not empty where an earlier history was lost."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Lines that cannot be read although later ones can."""

    line: int
    """Counted from 1: the first one that cannot be read."""
    version: int
    """Of the last edit that is lost."""


@dataclass(frozen=True, slots=True)
class Scan:
    """What a history file holds."""

    header: Header | None
    entries: tuple[Entry, ...]
    size: int
    """Bytes up to the end of the last line that can be read; what follows was never acknowledged."""
    gap: Gap | None = None
    """The last one, if there are any."""
    after_gap: tuple[Entry, ...] = field(default=())
    """Entries after the gap; all of them without one."""


def header_line(header: Header) -> bytes:
    """The first line of a history file."""
    return _seal(
        {
            "history": "jiti segments",
            "schema_version": SCHEMA_VERSION,
            "annotator": header.annotator,
            "episode_id": header.episode_id,
            "recording": asdict(header.recording),
            "version": header.version,
            "rows": [segment.to_row() for segment in header.rows],
        }
    )


def entry_line(entry: Entry) -> bytes:
    """The line of an edit."""
    return _seal(entry.to_json())


def scan(path: Path, data: bytes) -> Scan:
    """Read a history file's bytes. Raises NewerSchema, and LabelError for sealed lines that are not a history.

    One write adds one line, the first write two. So one broken line at the end (two in a file without any other)
    was being written when the process or the disk stopped, and is left out. Any other was acknowledged once: a gap.
    """
    header: Header | None = None
    entries: list[Entry] = []
    size = start = 0
    broken: list[int] = []
    gap: Gap | None = None
    first_after_gap = 0
    for number, line in enumerate(data.split(b"\n"), 1):
        end = start + len(line) + 1
        record = _unseal(line) if end <= len(data) else None
        if record is None:
            if line:
                broken.append(number)
            start = end
            continue
        if number == 1:
            header = _header(path, record)
            size = end
        else:
            entry = _entry(path, number, record)
            known = entries[-1].version if entries else header.version if header else None
            if known is not None and entry.version <= known:
                broken.append(number)
                start = end
                continue
            jumped = known is None or (entry.version != known + 1 and entry.kind != "recovered")
            if broken or jumped:
                gap = Gap(broken[0] if broken else number, entry.version - 1)
                first_after_gap = len(entries)
                broken = []
            entries.append(entry)
            size = end
        start = end
    if len(broken) > (1 if header or entries else 2):
        last = entries[-1].version if entries else header.version if header else 0
        gap = Gap(broken[0], last + len(broken) - 1)
        first_after_gap = len(entries)
    return Scan(header, tuple(entries), size, gap, tuple(entries[first_after_gap:]))


def _seal(record: Mapping[str, Any]) -> bytes:
    body = json.dumps(record, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
    return b'%s%s%08x"}\n' % (body[:-1], _SEAL, zlib.crc32(body))


def _unseal(line: bytes) -> dict[str, Any] | None:
    """The record, or None when the line is not whole."""
    body, _, seal = line.rpartition(_SEAL)
    return json.loads(body + b"}") if seal == b'%08x"}' % zlib.crc32(body + b"}") else None


def _header(path: Path, record: Mapping[str, Any]) -> Header:
    check_schema_version(path, record.get("schema_version"))
    try:
        return Header(
            record["annotator"],
            record["episode_id"],
            recording_from(record["recording"]),
            record["version"],
            _segments(record["rows"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise LabelError(f"{path}, line 1 is not the start of a history: {error}. Move the file away.") from error


def _entry(path: Path, number: int, record: Mapping[str, Any]) -> Entry:
    try:
        recording = record.get("recording")
        return Entry(
            record["version"],
            record["at"],
            record["kind"],
            record["action"],
            _segments(record["before"]),
            _segments(record["after"]),
            record.get("of"),
            None if recording is None else recording_from(recording),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise LabelError(f"{path}, line {number} is not an edit: {error}. Move the file away.") from error


def _segments(rows: Sequence[dict[str, Any]]) -> tuple[Segment, ...]:
    return tuple(Segment(**row) for row in rows)
