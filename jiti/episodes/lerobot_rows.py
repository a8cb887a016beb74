"""The rows of one episode in a LeRobot data file: found by row group, read in pieces, in the order of the frames."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.episodes.lerobot_info import INDEX_COLUMNS
from jiti.episodes.lerobot_parquet import damaged, open_parquet, to_numpy
from jiti.errors import SourceError


class EpisodeRows:
    """Where the rows of an episode are, and their index columns. Reading opens the file anew and closes it."""

    def __init__(self, path: Path, label: str, number: int) -> None:
        """Raises SourceError when the file cannot be read or has no row of episode `number`."""
        self.path, self.label = path, label
        with open_parquet(path, label) as file:
            self.schema = file.schema_arrow
            if "episode_index" not in self.schema.names:
                raise SourceError(
                    f"{label}: has no column 'episode_index'; it has {', '.join(self.schema.names)}. "
                    "Download the dataset again."
                )
            self._groups = _groups_of(file, number)
            names = [name for name in INDEX_COLUMNS if name in self.schema.names]
            try:
                table = file.read_row_groups(self._groups, names)
            except (pa.ArrowException, OSError) as error:
                raise damaged(label, error) from error
            mine = np.flatnonzero(_numbers(table, "episode_index") == number)
            if not len(mine):
                raise SourceError(
                    f"{label}: has no row of episode {number}. Download the dataset again, or correct meta/episodes."
                )
            self._rows = mine
            """Row of each frame, counted over the row groups."""
            self.index = {name: _numbers(table, name)[mine] for name in names}
            """Index columns by name, (frame_count,) float64, NaN where null, in the order of the frames."""
            self._bytes = _bytes_of(file, self._groups)

    @property
    def count(self) -> int:
        return len(self._rows)

    def reorder(self, order: np.ndarray) -> None:
        """Make row `order[i]` frame `i`."""
        self._rows = self._rows[order]
        self.index = {name: values[order] for name, values in self.index.items()}

    def max_bytes(self, column: str) -> int:
        """Upper bound of the bytes of this column in the episode."""
        return self._bytes[column]

    def batches(self, columns: Sequence[str], rows_at_once: int) -> Iterator[tuple[int, pa.RecordBatch]]:
        """Yield `(first frame, rows)` in the order of the frames, at most `rows_at_once` held at a time.

        One pass over the row groups; one a piece when the rows are shuffled in the file.
        """
        pieces = [self._rows]
        shuffled = bool((np.diff(self._rows) < 0).any())
        if shuffled:
            pieces = np.split(self._rows, np.arange(rows_at_once, self.count, rows_at_once))
        first = 0
        for piece in pieces:
            order = np.argsort(piece, kind="stable")
            held = []
            for batch in self._in_file_order(columns, piece[order], rows_at_once):
                if shuffled:
                    held.append(batch)
                    continue
                yield first, batch
                first += batch.num_rows
            if held:
                back = pa.array(np.argsort(order, kind="stable"))
                for batch in pa.Table.from_batches(held).take(back).combine_chunks().to_batches():
                    yield first, batch
                    first += batch.num_rows

    def _in_file_order(self, columns: Sequence[str], rows: np.ndarray, rows_at_once: int) -> Iterator[pa.RecordBatch]:
        with open_parquet(self.path, self.label) as file:
            start = 0
            try:
                for batch in file.iter_batches(rows_at_once, self._groups, list(columns)):
                    lo, hi = np.searchsorted(rows, [start, start + batch.num_rows])
                    mine = rows[lo:hi] - start
                    start += batch.num_rows
                    if len(mine) and mine[-1] - mine[0] + 1 == len(mine):
                        yield batch.slice(mine[0], len(mine))
                    elif len(mine):
                        yield batch.take(pa.array(mine))
                    if start > rows[-1]:
                        return
            except (pa.ArrowException, OSError) as error:
                raise damaged(self.label, error) from error


def to_floats(column: pa.Array, size: int) -> np.ndarray:
    """A column of numbers, lists of numbers or nested lists as (rows, size) float64.

    NaN for null, for what a short list lacks, and for what is no number; a longer list is cut.
    """
    if isinstance(column, pa.ExtensionArray):
        column = column.storage
    count, flat = len(column), column
    while _is_list(flat.type) and not flat.null_count and _same_lengths(flat):
        flat = flat.flatten()
    if len(flat) == count * size and not pa.types.is_nested(flat.type):
        values, valid = to_numpy(flat.cast(pa.float64(), safe=False))
        return np.where(valid, values, np.nan).reshape(count, size)
    values = np.full((count, size), np.nan)
    for row, cell in enumerate(column.to_pylist()):
        numbers = list(_flat(cell))[:size]
        values[row, : len(numbers)] = numbers
    return values


def is_numeric(kind: pa.DataType) -> bool:
    """Whether a column holds numbers, or lists of them at any depth."""
    if isinstance(kind, pa.BaseExtensionType):
        kind = kind.storage_type
    while _is_list(kind):
        kind = kind.value_type
    return pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)


def _is_list(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)


def _same_lengths(column: pa.Array) -> bool:
    """Whether all lists have one length: lists that only sum up to the right size must not slip into each other."""
    if pa.types.is_fixed_size_list(column.type):
        return True
    offsets, _ = to_numpy(column.offsets.cast(pa.int64()))
    lengths = np.diff(offsets)
    return not len(lengths) or bool((lengths == lengths[0]).all())


def _flat(cell: object) -> Iterator[float]:
    if isinstance(cell, list):
        for part in cell:
            yield from _flat(part)
    else:
        yield float(cell) if isinstance(cell, int | float) else np.nan


def _leaves(file: pq.ParquetFile) -> list[str]:
    """The column of each leaf of the schema: `observation.state` for `observation.state.list.element`."""
    names = sorted(file.schema_arrow.names, key=len, reverse=True)
    paths = [file.schema.column(leaf).path for leaf in range(file.metadata.num_columns)]
    return [next(name for name in names if path == name or path.startswith(f"{name}.")) for path in paths]


def _groups_of(file: pq.ParquetFile, number: int) -> list[int]:
    """Row groups that may hold the episode, by their statistics."""
    leaf = _leaves(file).index("episode_index")
    groups = []
    for group in range(file.metadata.num_row_groups):
        statistics = file.metadata.row_group(group).column(leaf).statistics
        if statistics is None or not statistics.has_min_max or statistics.min <= number <= statistics.max:
            groups.append(group)
    return groups


def _bytes_of(file: pq.ParquetFile, groups: Sequence[int]) -> dict[str, int]:
    """Bytes of each column in these row groups, before compression."""
    sizes = dict.fromkeys(file.schema_arrow.names, 0)
    for leaf, name in enumerate(_leaves(file)):
        for group in groups:
            sizes[name] += file.metadata.row_group(group).column(leaf).total_uncompressed_size
    return sizes


def _numbers(table: pa.Table, name: str) -> np.ndarray:
    """A scalar column (or lists of one) as (N,) float64."""
    return to_floats(table[name].combine_chunks(), 1)[:, 0] if table.num_rows else np.empty(0)
