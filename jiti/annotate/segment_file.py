"""One Parquet file of segments: what its bytes hold beside the rows, written and read."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

import jiti
from jiti.annotate.segments import SCHEMA, SCHEMA_VERSION, Segment
from jiti.errors import LabelError, NewerSchema

_KEY = b"jiti"
_columns_of = attrgetter(*SCHEMA.names)


class DamagedFile(LabelError):
    """A segments file cannot be read; its history can give it back."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What labels need to know of the recording that they are about."""

    frame_count: int
    frame_rate_hz: float
    fingerprint: str
    """Changes when the recording's bytes do."""

    def __post_init__(self) -> None:
        if self.frame_count < 0 or not (math.isfinite(self.frame_rate_hz) and self.frame_rate_hz > 0):
            raise LabelError(
                f"a recording of {self.frame_count} frames at {self.frame_rate_hz} Hz cannot be labelled; "
                "the count must be 0 or more and the rate more than 0"
            )


@dataclass(frozen=True, slots=True)
class FileInfo:
    """The metadata of a segments file, under the key `jiti`."""

    version: int | None = None
    """Edits up to this one are in the file; None for a file that jiti did not write."""
    annotator: str = ""
    recordings: Mapping[str, Recording] = field(default_factory=dict)
    """By episode id: one for a person's file, many for a machine's."""


def encode(segments: Iterable[Segment], info: FileInfo) -> pa.Buffer:
    """The bytes of a segments file."""
    columns = list(zip(*map(_columns_of, segments), strict=True)) or [()] * len(SCHEMA)
    about = {
        "schema_version": SCHEMA_VERSION,
        "version": info.version,
        "annotator": info.annotator,
        "recordings": {episode_id: asdict(recording) for episode_id, recording in info.recordings.items()},
    }
    table = pa.Table.from_arrays(
        [pa.array(values, field.type) for values, field in zip(columns, SCHEMA, strict=True)],
        schema=SCHEMA.with_metadata({_KEY: json.dumps(about)}),
    )
    sink = pa.BufferOutputStream()
    # Most files have a few rows: dictionaries and statistics cost more than they save, and zstd is slow to read.
    pq.write_table(
        table, sink, compression="snappy", use_dictionary=False, write_statistics=False, write_page_checksum=True
    )
    return sink.getvalue()


def decode(path: Path) -> tuple[pa.Table, FileInfo]:
    """Rows in the columns of `SCHEMA`, and the metadata.

    Raises DamagedFile when it is no Parquet file of segments, NewerSchema when a later jiti wrote it, OSError
    when it cannot be opened.
    """
    data = path.read_bytes()
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        schema = file.schema_arrow
        info = _info(path, schema.metadata or {})
        if schema.equals(SCHEMA):
            return file.read(use_threads=False).replace_schema_metadata(), info
        if missing := [name for name in SCHEMA.names if name not in schema.names]:
            raise DamagedFile(f"{path} is not a file of segments: it has no column {missing[0]!r}")
        return file.read(columns=SCHEMA.names, use_threads=False).select(SCHEMA.names).cast(SCHEMA), info
    except (pa.ArrowException, OSError, ValueError) as error:  # Arrow raises OSError for bytes that do not decode
        reason = "it is empty" if not data else str(error).partition("\n")[0][:200]
        raise DamagedFile(f"{path} cannot be read as segments: {reason}") from error


def to_segments(table: pa.Table) -> list[Segment]:
    """The rows as records; columns that a segment does not have are left out. Raises LabelError for a wrong value."""
    return [Segment(*row) for row in zip(*(table[name].to_pylist() for name in SCHEMA.names), strict=True)]


def check_schema_version(path: Path, version: Any) -> None:
    """Raises NewerSchema when a file is of a later schema than this jiti knows."""
    if isinstance(version, int) and version > SCHEMA_VERSION:
        raise NewerSchema(
            f"{path} has schema version {version}; jiti {jiti.__version__} reads versions up to {SCHEMA_VERSION}. "
            "Update with `pip install --upgrade jiti`; the file was left as it is."
        )


def recording_from(value: Mapping[str, Any]) -> Recording:
    """From the JSON object that `encode` and the history write. Raises ValueError."""
    try:
        return Recording(int(value["frame_count"]), float(value["frame_rate_hz"]), str(value["fingerprint"]))
    except (KeyError, TypeError, LabelError) as error:
        raise ValueError(f"the recording is described as {value!r}") from error


def _info(path: Path, metadata: Mapping[bytes, bytes]) -> FileInfo:
    if _KEY not in metadata:
        return FileInfo()
    about = json.loads(metadata[_KEY])
    check_schema_version(path, about.get("schema_version"))
    version, recordings = about.get("version"), about.get("recordings", {})
    if not isinstance(version, int) or not isinstance(recordings, dict):
        raise ValueError("its metadata is not what jiti writes")
    return FileInfo(
        version,
        str(about.get("annotator", "")),
        {episode_id: recording_from(value) for episode_id, value in recordings.items()},
    )
