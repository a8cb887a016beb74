"""Statistics of an episode and of a dataset: LeRobot's numbers, without LeRobot.

The operations and their order are those of lerobot/datasets/compute_stats.py (0.6.1): float32 stays float32, quantiles
are read from a histogram of 5000 bins, and a dataset's quantiles are the weighted mean of its episodes'.
"""

from collections.abc import Mapping

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""DEFAULT_QUANTILES of lerobot."""
BINS = 5000
"""num_quantile_bins of lerobot."""

Stats = dict[str, np.ndarray]
"""`min`, `max`, `mean`, `std`, `count` and the quantiles; all but `count` in the shape of the feature."""


def column_stats(values: np.ndarray) -> Stats:
    """Of one episode's rows (N, size), or (N,) for a feature of one number; not of no rows."""
    # In one order of memory: NumPy adds up along it, and float32 rounds as it does.
    batch = np.ascontiguousarray(values.reshape(len(values), -1))
    batch = batch.astype(np.result_type(batch.dtype, np.float32), copy=False)
    lowest, highest = batch.min(axis=0), batch.max(axis=0)
    mean = np.mean(batch, axis=0)
    if len(batch) < 2:
        stats = {"min": lowest, "max": highest, "mean": mean, "std": np.std(batch, axis=0)}
        return stats | {"count": np.array([len(batch)])} | {name: mean.copy() for name in QUANTILES}
    variance = np.mean(batch**2, axis=0) - mean**2
    stats = {"min": lowest, "max": highest, "mean": mean, "std": np.sqrt(np.maximum(0, variance))}
    stats["count"] = np.array([len(batch)])
    columns = []
    for k in range(batch.shape[1]):
        edges = np.linspace(lowest[k] - 1e-10, highest[k] + 1e-10, BINS + 1)
        counted, _ = np.histogram(batch[:, k], bins=edges)
        columns.append((np.cumsum(counted.astype(np.float64)), edges))
    for name, share in QUANTILES.items():
        stats[name] = np.array([_quantile(total, edges, share * len(batch)) for total, edges in columns])
    return stats


class LevelStats:
    """Statistics of the pictures of one episode by how often each channel has each of 256 levels.

    LeRobot adds float32 pixels one by one, which rounds; counting is exact and needs no memory of the pictures.
    """

    def __init__(self) -> None:
        self._counts = np.zeros((3, 256), np.int64)
        self._pictures = 0

    def add(self, picture: np.ndarray) -> None:
        """(height, width, 3) uint8."""
        for channel in range(3):
            self._counts[channel] += np.bincount(picture[:, :, channel].ravel(), minlength=256)
        self._pictures += 1

    def stats(self) -> Stats:
        """(3, 1, 1) each, in 0 to 1; `count` is the number of pictures."""
        levels = np.arange(256, dtype=np.float64)
        found: dict[str, list[float]] = {name: [] for name in ("min", "max", "mean", "std", *QUANTILES)}
        for counted in self._counts:
            there = np.flatnonzero(counted)
            total = counted.sum()
            mean = float((counted * levels).sum() / total)
            lowest, highest = np.float32(there[0]), np.float32(there[-1])
            edges = np.linspace(lowest - 1e-10, highest + 1e-10, BINS + 1)
            binned, _ = np.histogram(levels[there].astype(np.float32), bins=edges, weights=counted[there])
            cumulative = np.cumsum(binned)
            found["min"].append(float(lowest))
            found["max"].append(float(highest))
            found["mean"].append(mean)
            found["std"].append(float(np.sqrt((counted * (levels - mean) ** 2).sum() / total)))
            for name, share in QUANTILES.items():
                found[name].append(float(_quantile(cumulative, edges, share * total)))
        stats = {name: np.array(values).reshape(3, 1, 1) / 255.0 for name, values in found.items()}
        return {**stats, "count": np.array([self._pictures])}


def sampled(count: int) -> np.ndarray:
    """Frames of an episode whose pictures count for statistics: lerobot's `sample_indices`."""
    wanted = max(min(100, count), min(int(count**0.75), 10_000))
    return np.round(np.linspace(0, count - 1, wanted)).astype(int)


def thinned(picture: np.ndarray) -> np.ndarray:
    """Every n-th pixel of a large picture (height, width, 3): lerobot's `auto_downsample_height_width`."""
    height, width = picture.shape[:2]
    if max(width, height) < 300:
        return picture
    step = int(width / 150) if width > height else int(height / 150)
    return picture[::step, ::step]


def merged(total: Mapping[str, Stats] | None, episode: Mapping[str, Stats]) -> dict[str, Stats]:
    """Statistics of a dataset with one episode more: lerobot's `aggregate_stats` of the two."""
    if total is None:
        return dict(episode)
    return {key: _merged([total[key], episode[key]]) for key in episode}


def _merged(parts: list[Stats]) -> Stats:
    means = np.stack([part["mean"] for part in parts])
    variances = np.stack([part["std"] ** 2 for part in parts])
    counts = np.stack([part["count"] for part in parts])
    total = counts.sum(axis=0)
    weights = counts
    while weights.ndim < means.ndim:
        weights = np.expand_dims(weights, axis=-1)
    mean = (means * weights).sum(axis=0) / total
    variance = ((variances + (means - mean) ** 2) * weights).sum(axis=0) / total
    found = {
        "min": np.min(np.stack([part["min"] for part in parts]), axis=0),
        "max": np.max(np.stack([part["max"] for part in parts]), axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": total,
    }
    for name in QUANTILES:
        found[name] = (np.stack([part[name] for part in parts]) * weights).sum(axis=0) / total
    return found


def _quantile(cumulative: np.ndarray, edges: np.ndarray, target: float) -> float:
    at = int(np.searchsorted(cumulative, target))
    if at == 0:
        return edges[0]
    if at >= len(cumulative):
        return edges[-1]
    before = cumulative[at - 1]
    inside = cumulative[at] - before
    if inside == 0:
        return edges[at]
    return edges[at] + (target - before) / inside * (edges[at + 1] - edges[at])
