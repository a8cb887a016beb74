"""lerobot's own reader and trainer take a curated dataset as it is."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.builders.curate import curated, write_picks
from tests.builders.lerobot import FRONT
from tests.builders.mcap import Camera
from tests.builders.pictures import read_number

pytestmark = pytest.mark.slow  # lerobot takes ten seconds to import

MARKS = [[(5, 14, 1)], [(5, 14, 0)], [(5, 14, 1), (20, 29, 0)]]
OFFLINE = {**os.environ, "HF_HUB_OFFLINE": "1", "CUDA_VISIBLE_DEVICES": ""}


@pytest.fixture(scope="module", autouse=True)
def lerobot():
    return pytest.importorskip("lerobot", reason="install jiti[learn]")


@pytest.fixture(scope="module")
def demos(tmp_path_factory) -> Path:
    return write_picks(tmp_path_factory.mktemp("demos") / "demos", MARKS, cameras={"/camera/front": Camera()})


@pytest.mark.filterwarnings("ignore")
def test_lerobot_reads_what_was_recorded(demos, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    curated(demos, out=tmp_path / "d", gamma=0.5)
    dataset = LeRobotDataset("ann/d", root=tmp_path / "d", video_backend="pyav")
    assert (len(dataset), dataset.num_episodes, dataset.fps) == (30 + 36 + 42, 3, 30)
    for index in (0, 29, 30, 65, 66, 107):
        row = dataset[index]
        start = max(first for first in (0, 30, 66) if first <= index)
        assert read_number((row[FRONT].numpy().transpose(1, 2, 0) * 255).astype(np.uint8)) == index - start
        assert row["task"] == "pick the cube"
        assert bool(row["next.done"]) == (index in (29, 65, 107))
    assert float(dataset[14]["elegance.mc_return"]) == 1
    assert float(dataset[13]["elegance.mc_return"]) == 1.5
    assert float(dataset[35]["next.reward"]) == 0
    assert bool(dataset[35]["elegance.annotated"])
    assert dataset.meta.stats[FRONT]["mean"].shape == (3, 1, 1)


@pytest.mark.filterwarnings("ignore")
def test_the_files_are_laid_out_as_lerobot_lays_them_out(demos, tmp_path, monkeypatch):
    """The same numbers through `add_frame` and `save_episode`: same schemas, features and statistics."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    curated(write_picks(tmp_path / "plain", MARKS), out=tmp_path / "d")
    ours = pq.read_table(tmp_path / "d" / "data" / "chunk-000" / "file-000.parquet")
    info = json.loads((tmp_path / "d" / "meta" / "info.json").read_text())
    index = ("timestamp", "frame_index", "episode_index", "index", "task_index")
    features = {key: {**f, "shape": tuple(f["shape"])} for key, f in info["features"].items() if key not in index}
    theirs = LeRobotDataset.create("ann/t", info["fps"], features, root=tmp_path / "t", use_videos=False)
    for row in ours.to_pylist():
        frame = {key: np.array(row[key], f["dtype"]).reshape(f["shape"]) for key, f in features.items()}
        theirs.add_frame({**frame, "task": "pick the cube"})
        if row["next.done"]:
            theirs.save_episode()
    theirs.finalize()
    for name in ("data/chunk-000/file-000.parquet", "meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"):
        mine, other = pq.read_table(tmp_path / "d" / name), pq.read_table(tmp_path / "t" / name)
        assert mine.schema.remove_metadata().equals(other.schema.remove_metadata()), name
        for column in mine.column_names:
            assert mine[column].to_pylist() == other[column].to_pylist(), f"{name}, {column}"
    for name in ("info.json", "stats.json"):
        mine, other = (json.loads((tmp_path / folder / "meta" / name).read_text()) for folder in ("d", "t"))
        assert mine == other, name


def train(dataset: Path, out: Path, *more: str) -> str:
    """Run `lerobot-train` for 100 steps on a processor; gives what it printed."""
    command = [
        sys.executable, "-m", "lerobot.scripts.lerobot_train",
        "--dataset.repo_id=ann/d", f"--dataset.root={dataset}", f"--output_dir={out}",
        "--policy.device=cpu", "--policy.push_to_hub=false", "--steps=100", "--batch_size=4", "--num_workers=0",
        "--log_freq=50", "--save_checkpoint=false", "--wandb.enable=false", *more,
    ]  # fmt: skip
    ended = subprocess.run(command, env=OFFLINE, capture_output=True, text=True, check=False)
    said = ended.stdout + ended.stderr
    assert ended.returncode == 0, said[-3000:]
    assert "End of training" in said
    return said


@pytest.fixture(scope="module")
def from_scene(tmp_path_factory) -> Path:
    """State, action and scene state of two demonstrations in simulation."""
    pytest.importorskip("mujoco", reason="install jiti[sim]")
    folder = tmp_path_factory.mktemp("scene")
    record = [sys.executable, "-m", "jiti", "record", "--task", "T2", "--episodes", "2", "--cameras", "none"]
    subprocess.run([*record, "--out", str(folder / "demos")], check=True, capture_output=True)
    propose = [sys.executable, "-m", "jiti", "autolabel", str(folder / "demos")]
    subprocess.run(propose, check=True, capture_output=True)
    curated(folder / "demos", out=folder / "d", accept=("sim",), weights=True)
    return folder / "d"


ACT = (
    "--policy.type=act", "--policy.dim_model=32", "--policy.n_heads=2", "--policy.dim_feedforward=64",
    "--policy.n_encoder_layers=1", "--policy.chunk_size=10", "--policy.n_action_steps=10", "--policy.use_vae=false",
)  # fmt: skip
"""lerobot's smallest policy that takes numbers alone."""


@pytest.mark.sim
def test_lerobot_trains_on_it_as_it_is(from_scene, tmp_path):
    train(from_scene, tmp_path / "run", *ACT)


@pytest.mark.sim
def test_lerobot_trains_with_the_weights(from_scene, tmp_path):
    """A policy whose loss lerobot can weigh: of its own only large ones, so ours."""
    said = train(
        from_scene, tmp_path / "run", "--policy.discover_packages_path=jiti.policies",
        "--policy.type=state_flow", "--sample_weighting.type=rabc",
    )  # fmt: skip
    assert "sarm_progress.parquet" in said
