"""What was read from many small label files, kept as one file in the user's cache folder. It can always be deleted."""

import hashlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import platformdirs
import pyarrow as pa

from jiti.annotate.segments import SCHEMA
from jiti.durable import make_folder, write_atomic
from jiti.errors import SaveFailed

WORTH_FILES = 200
"""Files from which on a cache is kept. Our choice: fewer are read in some tens of milliseconds."""

WORTH_CHANGES = 50
"""Changed files from which on the cache is written again. Our choice: reading fewer costs less than writing it."""

ROWS = SCHEMA.append(pa.field("file", pa.int64()))
"""A segment, and the number of the file that it is in."""

RECORDINGS = pa.schema(
    [
        pa.field("annotator", pa.string()),
        pa.field("episode_id", pa.string()),
        pa.field("frame_count", pa.int64()),
        pa.field("frame_rate_hz", pa.float64()),
        pa.field("fingerprint", pa.string()),
    ]
)
RECORDINGS_IN_FILE = RECORDINGS.remove(0).append(pa.field("file", pa.int64()))

_KEYS = pa.schema([pa.field("key", pa.string())])

FileKey = str
"""Name, size, time and inode of a file: differs when the file does, because every write makes a new inode."""


@dataclass(frozen=True, slots=True)
class Kept:
    """The content of a cache file."""

    index: dict[FileKey, int]
    """Number of each file, as in the column `file`."""
    rows: pa.Table
    recordings: pa.Table

    @staticmethod
    def nothing() -> "Kept":
        return Kept({}, ROWS.empty_table(), RECORDINGS_IN_FILE.empty_table())


def path_for(labels_dir: Path, cache_dir: Path | None = None) -> Path:
    """Where the labels of a folder are kept."""
    root = cache_dir or platformdirs.user_cache_path("jiti")
    return root / "labels" / f"{hashlib.sha256(str(labels_dir.resolve()).encode()).hexdigest()[:24]}.arrow"


def load(path: Path) -> Kept:
    """What was kept; nothing when the file is missing, damaged or of another layout."""
    try:
        with pa.memory_map(str(path)) as source:
            keys, rows, recordings = (pa.ipc.open_stream(source).read_all() for _ in range(3))
    except (OSError, pa.ArrowException):
        return Kept.nothing()
    if (keys.schema, rows.schema, recordings.schema) != (_KEYS, ROWS, RECORDINGS_IN_FILE):
        return Kept.nothing()
    return Kept({key: number for number, key in enumerate(keys["key"].to_pylist())}, rows, recordings)


def save(path: Path, keys: list[FileKey], rows: pa.Table, recordings: pa.Table) -> None:
    """Keep what was read. A cache folder that cannot be written costs time at the next reading and nothing else."""
    sink = pa.BufferOutputStream()
    for table in (pa.table([keys], schema=_KEYS), rows, recordings):
        with pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
    with suppress(SaveFailed):
        make_folder(path.parent)
        write_atomic(path, memoryview(sink.getvalue()))
