"""Observations of a dataset in index order, as batches for an extractor: numbers alone, or pictures by lerobot."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jiti.critic.dataset import state_columns
from jiti.critic.features.base import Batch


def observations(root: Path, needs: Sequence[str], first: int, stop: int, batch: int) -> Iterator[Batch]:
    """Batches of frames `first` to `stop - 1`, of at most `batch` frames each, with the keys of `needs`."""
    if all(key.startswith("observation.") and ".images." not in key for key in needs):
        return _numbers(root, tuple(needs), first, stop, batch)
    return _items(root, first, stop, batch)


_columns: dict[tuple[Path, tuple[str, ...]], dict[str, np.ndarray]] = {}


def _numbers(root: Path, keys: tuple[str, ...], first: int, stop: int, batch: int) -> Iterator[Batch]:
    import torch

    if (root, keys) not in _columns:
        _columns.clear()
        _columns[root, keys] = state_columns(root, keys)
    columns = _columns[root, keys]
    for begin in range(first, stop, batch):
        yield {key: torch.from_numpy(values[begin : min(begin + batch, stop)]) for key, values in columns.items()}


_datasets: dict[Path, Any] = {}


def _items(root: Path, first: int, stop: int, batch: int) -> Iterator[Batch]:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import default_collate

    if root not in _datasets:
        _datasets.clear()
        _datasets[root] = LeRobotDataset(root.name, root=root)
    dataset = _datasets[root]
    for begin in range(first, stop, batch):
        yield default_collate([dataset[index] for index in range(begin, min(begin + batch, stop))])
