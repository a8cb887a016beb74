"""What a trained critic makes of demonstrations, for the paper's static baselines (supplement G.3): which to keep, and
weights of frames.

The paper says no more than that its critic reshapes the data. Our choice: Filtered Data is the half of each task's
demonstrations whose recorded chunks it values most, on the mean over their frames; Weighted Data are lerobot's RA-BC
weights of `jiti curate --weights-from`.
"""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jiti.durable import make_folder, write_atomic
from jiti.progress import Progress

KEPT, WEIGHTS = "kept.json", "progress.parquet"
"""Indices of the episodes of the better halves, as `lerobot-train --dataset.episodes` takes them; what
`--sample_weighting.progress_path` takes."""


def make_values(critic: Path, dataset: Path, out: Path, features: Path, progress: Progress) -> dict[str, Any]:
    """Write both files for a dataset; say how many are kept, and how many of them have a reward. Raises JitiError."""
    from jiti.critic.weigh import Weigher
    from jiti.curate.export.weights import write_weights

    found = list(Weigher(critic, features_dir=features).values(dataset, progress))
    make_folder(out)
    write_weights(out / WEIGHTS, enumerate(one.progress for one in found))
    kept = better_half([one.task for one in found], [float(one.q.mean()) for one in found])
    write_atomic(out / KEPT, json.dumps(kept).encode())
    return {"episodes": len(kept), "rewarded": sum(bool((found[place].reward > 0).any()) for place in kept)}


def better_half(tasks: Sequence[str], values: Sequence[float]) -> list[int]:
    """Places of those of each task that have the highest values, in order; of an odd number the middle one too."""
    by_task: Mapping[str, list[int]] = defaultdict(list)
    for place, task in enumerate(tasks):
        by_task[task].append(place)
    kept: list[int] = []
    for places in by_task.values():
        kept += sorted(places, key=lambda place: -values[place])[: (len(places) + 1) // 2]
    return sorted(kept)
