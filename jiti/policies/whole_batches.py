"""Read a batch of frames of a LeRobotDataset at once, so that learning from state does not wait for reading.

lerobot 0.6.1 reads frame by frame, 7 ms each on a CPU: 1.7 s for a batch of 256, of which a small policy learns in
0.02 s. torch's loader asks a dataset for a whole batch where it has `__getitems__`, and collates it by a function that
it looks up by type; `install` adds both. A batch is the same, number by number, as one of frames that were read one by
one, and what has pictures or language columns is still read so. lerobot imports this module with the policies of
`jiti.policies`, and only then is anything changed.
"""

from collections.abc import Iterable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch  # noqa: TID253 - lerobot's plugin
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: TID253
from torch.utils.data._utils.collate import default_collate_fn_map  # noqa: TID253


class Whole(dict[str, Any]):
    """A batch that is one already: what `default_collate` would make of its frames, by the dataset's keys."""


def install() -> None:
    """Let torch's loader read whole batches. Only into this process: loaders with workers read one by one.

    A loader with a `collate_fn` of its own that is no `default_collate` is given a list of one `Whole`, and must take
    it as the batch; lerobot's has one for language columns alone, which are read one by one.
    """
    if not hasattr(LeRobotDataset, "__getitems__"):
        LeRobotDataset.__getitems__ = items  # pyright: ignore[reportAttributeAccessIssue]
        default_collate_fn_map[Whole] = lambda batch, **_unused: dict(batch[0])


def items(dataset: LeRobotDataset, indices: list[int]) -> list[Any]:
    """What `default_collate` makes a batch of: the frames, or one `Whole` where all columns are numbers."""
    columns = _columns_of(dataset)
    if columns is None:
        return [dataset[index] for index in indices]
    at = np.asarray(indices, np.int64)
    rows: dict[str, torch.Tensor] = {name: torch.from_numpy(values[at]) for name, values in columns.values.items()}
    ahead: dict[str, torch.Tensor] = {}
    first, last = columns.first[at], columns.last[at]
    assert dataset.reader is not None
    for name, deltas in (dataset.reader.delta_indices or {}).items():
        wanted = at[:, None] + np.asarray(deltas, np.int64)
        ahead[f"{name}_is_pad"] = torch.from_numpy((wanted < first[:, None]) | (wanted > last[:, None]))
        rows[name] = torch.from_numpy(columns.values[name][np.clip(wanted, first[:, None], last[:, None])])
    tasks = [columns.tasks[int(index)] for index in rows["task_index"]]
    return [Whole(rows | ahead, task=tasks)]


class _Columns:
    """A dataset's numbers as arrays (frames, …), and the first and last row (frames,) of each frame's episode."""

    def __init__(self, dataset: LeRobotDataset) -> None:
        table = dataset.hf_dataset.data
        self.values = {name: _array(table.column(name)) for name in table.column_names}
        # Rows of one episode lie together, also where a part of the episodes is read.
        episode = self.values["episode_index"]
        starts = np.flatnonzero(np.r_[True, episode[1:] != episode[:-1]])
        lengths = np.diff(np.r_[starts, len(episode)])
        self.first = np.repeat(starts, lengths)
        self.last = self.first + np.repeat(lengths, lengths) - 1
        self.tasks = [str(task) for task in _tasks(dataset)]


_known: "WeakKeyDictionary[LeRobotDataset, _Columns | None]" = WeakKeyDictionary()


def _columns_of(dataset: LeRobotDataset) -> _Columns | None:
    """None where frames must be read one by one."""
    if dataset not in _known:
        meta = dataset.meta
        plain = not meta.camera_keys and not meta.has_language_columns and dataset.hf_dataset._indices is None
        numeric = all(feature["dtype"] not in ("string", "image", "video") for feature in meta.features.values())
        _known[dataset] = _Columns(dataset) if plain and numeric else None
    return _known[dataset]


def _tasks(dataset: LeRobotDataset) -> Iterable[Any]:
    tasks = dataset.meta.tasks
    return () if tasks is None else tasks.index


def _array(column: Any) -> np.ndarray:
    """(frames, …) of an Arrow column, in the types that torch gives Python's numbers."""
    chunk = column.combine_chunks()
    shape: list[int] = [len(chunk)]
    while hasattr(chunk, "flatten") and hasattr(chunk.type, "value_type"):
        flat = chunk.flatten()
        shape.append(len(flat) // max(1, int(np.prod(shape))))
        chunk = flat
    values = chunk.to_numpy(zero_copy_only=False).reshape(shape)
    kinds = {"f": np.float32, "i": np.int64, "u": np.int64, "b": np.bool_}
    return np.ascontiguousarray(values, kinds[values.dtype.kind])


install()
