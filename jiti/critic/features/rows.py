"""Observations of a dataset in index order, as batches for an extractor: numbers alone, or pictures by lerobot."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from jiti.critic.dataset import instructions, state_columns
from jiti.critic.features.base import Batch

TASK = "task"
"""The key of a batch's instructions."""


def observations(
    root: Path, fingerprint: str, needs: Sequence[str], first: int, stop: int, batch: int
) -> Iterator[Batch]:
    """Batches of frames `first` to `stop - 1`, of at most `batch` frames each, with the keys of `needs`.

    `fingerprint` is the dataset's: what a process has read of a dataset is used again only while it is the same.
    """
    if any(".image" in key for key in needs):
        return _items(root, fingerprint, first, stop, batch)
    return _numbers(root, fingerprint, tuple(needs), first, stop, batch)


_columns: dict[tuple[str, tuple[str, ...]], dict[str, Any]] = {}


def _numbers(root: Path, fingerprint: str, keys: tuple[str, ...], first: int, stop: int, batch: int) -> Iterator[Batch]:
    import torch

    if (fingerprint, keys) not in _columns:
        _columns.clear()
        read: dict[str, Any] = dict(state_columns(root, tuple(key for key in keys if key != TASK)))
        _columns[fingerprint, keys] = read | ({TASK: instructions(root)} if TASK in keys else {})
    columns = _columns[fingerprint, keys]
    for begin in range(first, stop, batch):
        rows = slice(begin, min(begin + batch, stop))
        yield {
            key: values[rows].tolist() if key == TASK else torch.from_numpy(values[rows])
            for key, values in columns.items()
        }


_datasets: dict[str, Any] = {}


def _items(root: Path, fingerprint: str, first: int, stop: int, batch: int) -> Iterator[Batch]:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import default_collate

    if fingerprint not in _datasets:
        _datasets.clear()
        _datasets[fingerprint] = LeRobotDataset(root.name, root=root)
    dataset = _datasets[fingerprint]
    for begin in range(first, stop, batch):
        yield default_collate([dataset[index] for index in range(begin, min(begin + batch, stop))])
