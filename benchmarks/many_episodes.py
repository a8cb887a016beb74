"""A LeRobot v3 dataset of 10,000 episodes with labels by two annotators, laid out as lerobot and jiti write them."""

import json
import shutil
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from bench import Bench, Say

from jiti.annotate.folder import segments_path
from jiti.annotate.segment_file import FileInfo, Recording, encode
from jiti.annotate.segments import Segment, new_segment_id

FPS = 30
FRAMES = 300
WINDOW = 25
"""Length of most segments, the paper's."""
TASKS = ("Pick up the cube and place it in the tray.", "Push the plate to the front of the stove.")
CONSTRAINTS = ("grasp", "align", "release", "clear")
MOTORS = [f"joint_{k}.pos" for k in range(1, 7)] + ["gripper.pos"]
EPISODES_A_FILE = 1000
SECOND_SHARE = 10
"""Every tenth episode is labelled by the second annotator as well."""


def dataset(bench: Bench, episodes: int) -> Path:
    """A dataset of so many episodes of 300 frames, without video, made once; labels in `meta/jiti`."""
    root = bench.kept / "datasets-1" / f"{episodes}-episodes"
    if not (root / "complete").exists():
        shutil.rmtree(root, ignore_errors=True)
        with bench.progress(f"Making {episodes:,} episodes") as say:
            _write_data(root, episodes, say)
            _write_labels(root / "meta" / "jiti", episodes, say)
        (root / "complete").touch()
    return root


def _write_data(root: Path, episodes: int, say: Say) -> None:
    draw = np.random.default_rng(0)
    rows: list[dict[str, Any]] = []
    for first in range(0, episodes, EPISODES_A_FILE):
        file = first // EPISODES_A_FILE
        path = root / f"data/chunk-000/file-{file:03d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = None
        for episode in range(first, min(first + EPISODES_A_FILE, episodes)):
            table = _frames(draw, episode)
            writer = writer or pq.ParquetWriter(path, table.schema)
            writer.write_table(table)
            rows.append(
                {
                    "episode_index": episode,
                    "tasks": [TASKS[episode % len(TASKS)]],
                    "length": FRAMES,
                    "data/chunk_index": 0,
                    "data/file_index": file,
                    "dataset_from_index": episode * FRAMES,
                    "dataset_to_index": (episode + 1) * FRAMES,
                    "stats/action/mean": [0.0] * len(MOTORS),
                    "stats/action/std": [1.0] * len(MOTORS),
                }
            )
            say(0.5 * episode / episodes, "frames")
        if writer:
            writer.close()
    meta = root / "meta"
    (meta / "episodes/chunk-000").mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows), meta / "episodes/chunk-000/file-000.parquet")
    pq.write_table(
        pa.table({"task_index": list(range(len(TASKS))), "__index_level_0__": list(TASKS)}), meta / "tasks.parquet"
    )
    (meta / "info.json").write_text(json.dumps(_info(episodes), indent=4))


def _frames(draw: np.random.Generator, episode: int) -> pa.Table:
    """One episode: joints that swing, each episode a little differently."""
    time_s = np.arange(FRAMES) / FPS
    phase, speed = draw.normal(size=len(MOTORS)), 1 + 0.2 * draw.normal(size=len(MOTORS))
    state = np.sin(time_s[:, None] * speed + phase) + 0.002 * draw.normal(size=(FRAMES, len(MOTORS)))
    columns = {
        name: pa.FixedSizeListArray.from_arrays(values.astype(np.float32).ravel(), len(MOTORS))
        for name, values in (("observation.state", state), ("action", np.roll(state, -1, 0)))
    }
    frame = np.arange(FRAMES)
    return pa.table(
        columns
        | {
            "timestamp": pa.array(time_s.astype(np.float32)),
            "frame_index": frame,
            "episode_index": np.full(FRAMES, episode),
            "index": frame + episode * FRAMES,
            "task_index": np.full(FRAMES, episode % len(TASKS)),
        }
    )


def _info(episodes: int) -> dict[str, Any]:
    vector = {"dtype": "float32", "shape": [len(MOTORS)], "names": MOTORS}
    whole = {"dtype": "int64", "shape": [1], "names": None}
    return {
        "codebase_version": "v3.0",
        "robot_type": "so100",
        "total_episodes": episodes,
        "total_frames": episodes * FRAMES,
        "total_tasks": len(TASKS),
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {
            "observation.state": vector,
            "action": vector,
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), whole),
        },
    }


def _write_labels(labels_dir: Path, episodes: int, say: Say) -> None:
    """One file an episode and annotator, about three segments each. Histories are left out: RVV reads none."""
    draw = Random(0)
    for name in ("ann", "ben"):
        segments_path(labels_dir, name, "x").parent.mkdir(parents=True, exist_ok=True)
    for episode in range(episodes):
        episode_id = f"episode_{episode:06d}"
        about = {episode_id: Recording(FRAMES, float(FPS), f"{episode:032x}")}
        rows = [_segment(draw, episode, episode_id, n) for n in range(draw.choice((2, 3, 3, 4)))]
        others = [_second_opinion(draw, row) for row in rows] if episode % SECOND_SHARE == 0 else None
        for name, theirs in (("ann", rows), ("ben", others)):
            if theirs is not None:
                data = encode(theirs, FileInfo(len(theirs), name, about))
                segments_path(labels_dir, name, episode_id).write_bytes(data)
        say(0.5 + 0.5 * episode / episodes, "labels")


def _segment(draw: Random, episode: int, episode_id: str, number: int) -> Segment:
    start = 10 + 70 * number + draw.randrange(30)
    end = start + draw.choice((WINDOW, WINDOW, WINDOW, 15, 40)) - 1
    reward = None if draw.random() < 0.01 else int(draw.random() < 0.7)
    now = 1_735_689_600_000_000_000 + episode
    return Segment(
        segment_id=new_segment_id(),
        episode_id=episode_id,
        itc_id=f"task-{episode % len(TASKS)}/{CONSTRAINTS[number]}",
        criterion="task_sequence_integrity",
        start_frame=start,
        end_frame=end,
        start_ns=start * 10**9 // FPS,
        end_ns=end * 10**9 // FPS,
        reward=reward,
        rationale="the gripper slipped" if draw.random() < 0.1 else None,
        created_at=now,
        updated_at=now,
    )


def _second_opinion(draw: Random, row: Segment) -> Segment:
    """The same segment as another person would have marked it: other edges, seldom another verdict."""
    reward = 1 - row.reward if row.reward is not None and draw.random() < 0.05 else row.reward
    start, end = row.start_frame + draw.randrange(-3, 4), row.end_frame + draw.randrange(-3, 4)
    return row.changed(segment_id=new_segment_id(), start_frame=start, end_frame=end, reward=reward)
