"""Segments and recordings for tests of labels."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa

from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import SCHEMA, Segment, new_segment_id

RECORDING = Recording(frame_count=300, frame_rate_hz=30.0, fingerprint="f00d")


def segment(start: int = 10, end: int = 34, reward: int | None = 1, **fields: object) -> Segment:
    """Frames `start` to `end` at 30 Hz, by a person, of episode `ep` and ITC `t/hold` unless said otherwise."""
    values: dict = {
        "segment_id": new_segment_id(),
        "episode_id": "ep",
        "itc_id": "t/hold",
        "criterion": "task_sequence_integrity",
        "start_ns": start * 1_000_000_000 // 30,
        "end_ns": end * 1_000_000_000 // 30,
        **fields,
    }
    return Segment(start_frame=start, end_frame=end, reward=reward, **values)


@contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """No file of this process grows beyond `limit` bytes: writes stop part of the way, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Root writes to read-only folders as well; inside this, root is nobody."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def names_in(folder: Path) -> list[str]:
    """Everything in a folder, hidden files as well."""
    return sorted(path.name for path in folder.iterdir())


def table(*rows: tuple[str, Segment]) -> pa.Table:
    """What `read_segments` gives for these annotators' rows."""
    columns = {name: [getattr(row, name) for _, row in rows] for name in SCHEMA.names}
    annotators = pa.array([annotator for annotator, _ in rows], pa.string())
    return pa.table(columns, schema=SCHEMA).append_column("annotator", annotators)
