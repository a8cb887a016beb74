"""A small D_elegant, written column by column as `jiti curate` and lerobot do."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.curate.returns import mc_returns


@dataclass(frozen=True)
class Recorded:
    """One episode: states (T, n), actions (T, A), rewards (T,), which frames are annotated (T,)."""

    state: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    annotated: np.ndarray
    task: str = "elegant/T0"
    split: str = "train"
    scene: np.ndarray | None = None


def write_elegant(
    root: Path, episodes: Sequence[Recorded], *, gamma: float = 0.98, fps: int = 20, files: int = 1
) -> Path:
    """Write the episodes as a LeRobot v3 dataset with the columns of D_elegant, in `files` data files."""
    lengths = [len(e.reward) for e in episodes]
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    reward = np.concatenate([e.reward for e in episodes]).astype(np.float32)
    tasks = sorted({e.task for e in episodes})
    columns: dict[str, pa.Array] = {
        "observation.state": _lists(np.concatenate([e.state for e in episodes])),
        "action": _lists(np.concatenate([e.action for e in episodes])),
        "next.reward": pa.array(reward),
        "next.done": pa.array(np.isin(np.arange(offsets[-1]), offsets[1:] - 1)),
        "elegance.annotated": pa.array(np.concatenate([e.annotated for e in episodes]).astype(bool)),
        "elegance.mc_return": pa.array(mc_returns(reward, offsets, gamma).astype(np.float32)),
        "timestamp": pa.array(np.concatenate([np.arange(n) / fps for n in lengths]).astype(np.float32)),
        "frame_index": pa.array(np.concatenate([np.arange(n) for n in lengths])),
        "episode_index": pa.array(np.repeat(np.arange(len(lengths)), lengths)),
        "index": pa.array(np.arange(offsets[-1])),
        "task_index": pa.array(np.repeat([tasks.index(e.task) for e in episodes], lengths)),
    }
    if episodes[0].scene is not None:
        columns["observation.environment_state"] = _lists(
            np.concatenate([e.scene for e in episodes if e.scene is not None])
        )
    table = pa.table(columns)
    (root / "data/chunk-000").mkdir(parents=True)
    (root / "meta/jiti").mkdir(parents=True)
    cuts = np.linspace(0, len(table), files + 1).astype(int)
    for number, (first, stop) in enumerate(pairwise(cuts)):
        pq.write_table(table.slice(first, stop - first), root / f"data/chunk-000/file-{number:03d}.parquet")
    shapes = {
        name: [column.type.list_size] if pa.types.is_fixed_size_list(column.type) else [1]
        for name, column in columns.items()
    }
    info = {
        "codebase_version": "v3.0",
        "fps": fps,
        "total_frames": int(offsets[-1]),
        "total_episodes": len(episodes),
        "features": {name: {"dtype": "float32", "shape": shape, "names": None} for name, shape in shapes.items()},
    }
    named = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": [f"do {task}" for task in tasks]})
    pq.write_table(named, root / "meta/tasks.parquet")
    (root / "meta/info.json").write_text(json.dumps(info))
    (root / "meta/jiti/curate.json").write_text(json.dumps({"gamma": gamma, "fps": fps}))
    rows = pa.table(
        {
            "episode_index": pa.array(range(len(episodes)), pa.int64()),
            "episode_id": [f"recorded_{n}" for n in range(len(episodes))],
            "fingerprint": [hashlib.sha256(e.action.tobytes()).hexdigest()[:16] for e in episodes],
            "task_id": [e.task for e in episodes],
            "split": [e.split for e in episodes],
            "frames": pa.array(lengths, pa.int64()),
        }
    )
    pq.write_table(rows, root / "meta/jiti/episodes.parquet")
    return root


def _lists(rows: np.ndarray) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(rows.astype(np.float32).ravel()), rows.shape[1])
