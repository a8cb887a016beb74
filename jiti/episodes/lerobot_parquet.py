"""Open Parquet files and read chosen columns, with errors that say what is wrong with the file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.errors import SourceError

READ_BUFFER_BYTES = 1 << 20
"""Parquet columns are read through a window of this size instead of whole. Our choice."""


def open_parquet(path: Path, label: str) -> pq.ParquetFile:
    """Open a file; the caller closes it. Raises SourceError that names it as `label`."""
    try:
        with path.open("rb") as file:
            head = file.read(64)
            file.seek(0, 2)
            size = file.tell()
            file.seek(max(0, size - 4))
            tail = file.read()
    except OSError as error:
        raise SourceError(
            f"{label}: the file is missing or cannot be opened ({error.strerror}). Download the dataset again."
        ) from error
    if head.startswith(b"version https://git-lfs"):
        raise SourceError(f"{label}: this is a Git LFS pointer, not the data. Run `git lfs pull` in the dataset.")
    if head[:4] == b"PAR1" and tail != b"PAR1":
        raise SourceError(
            f"{label}: the file has no footer ({size} bytes): its recorder was killed before it was finalized, or the "
            "download was cut off. Record these episodes again or download the file again; the other files stay usable."
        )
    try:
        return pq.ParquetFile(path, buffer_size=READ_BUFFER_BYTES)
    except (pa.ArrowException, OSError, ValueError) as error:  # ValueError: a name or a text that is not UTF-8
        raise SourceError(f"{label}: is not a Parquet file ({_short(error)}). Download it again.") from error


def read_columns(path: Path, label: str, columns: Sequence[str] | None, needed: Sequence[str]) -> pa.Table:
    """Read those of the columns that are there (None: all). Raises SourceError when a needed one is missing."""
    with open_parquet(path, label) as file:
        try:
            there = set(file.schema_arrow.names)
        except (pa.ArrowException, ValueError) as error:
            raise damaged(label, error) from error
        if missing := [name for name in needed if name not in there]:
            raise SourceError(
                f"{label}: has no column {missing[0]!r}; it has {', '.join(sorted(there)[:12]) or 'none'}. "
                "Download the dataset again, or write it with lerobot 0.4 or later."
            )
        try:
            return file.read(None if columns is None else [name for name in columns if name in there])
        except (pa.ArrowException, OSError, ValueError) as error:
            raise damaged(label, error) from error


def to_numpy(array: pa.Array) -> tuple[np.ndarray, np.ndarray]:
    """Values (N,) of an int64 or float64 array, and which of them are not null, (N,) bool.

    Arrow's own conversion imports pandas where it is installed, which takes half a second.
    """
    if not len(array):
        return np.empty(0, np.int64 if pa.types.is_int64(array.type) else np.float64), np.empty(0, bool)
    valid, values = array.buffers()
    span = slice(array.offset, array.offset + len(array))
    numbers = np.frombuffer(values, np.int64 if pa.types.is_int64(array.type) else np.float64)[span]
    if valid is None:
        return numbers, np.ones(len(array), bool)
    return numbers, np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[span].astype(bool)


def damaged(label: str, error: Exception) -> SourceError:
    return SourceError(f"{label}: the file is damaged ({_short(error)}). Download or record it again.")


def _short(error: Exception) -> str:
    """The first line of Arrow's message, which can run over many."""
    return str(error).strip().split("\n")[0].rstrip(".")[:200]
