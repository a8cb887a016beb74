"""Weights by a critic, from the command line: lerobot prefers the chunks that the critic prefers."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from jiti.cli import app
from jiti.critic.dataset import read_elegant
from jiti.critic.ranking import decided_segments
from jiti.critic.settings import LossSettings, NetworkSettings, OptimizerSettings, RunSettings, Settings
from jiti.critic.train import train
from jiti.errors import SourceError, UsageError
from tests.builders.curate import curated, write_picks
from tests.critic.elegant import Recorded, write_elegant

TINY = Settings(
    network=NetworkSettings(width=16, heads=2, actor_width=16, chunk=4),
    loss=LossSettings(td_offset=4, alpha=1.0),
    optimizer=OptimizerSettings(critic_lr=3e-3),
    run=RunSettings(steps=90, batch=16, check_every=30, device="cpu"),
)
CHUNK = 4


@pytest.fixture
def features(tmp_path, monkeypatch):
    """The user's cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "jiti" / "features"


def curate(*arguments) -> str:
    done = CliRunner().invoke(app, ["curate", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def test_chunks_that_reach_into_satisfied_segments_weigh_more(toy, features):
    run = toy.parent / "run"
    train(toy, run, TINY, features_dir=features)
    path = toy / "sarm_progress.parquet"
    assert json.loads(curate(toy, "--weights-from", run, "--json")) == {"weights": str(path)}

    data, table = read_elegant(toy), pq.read_table(path)
    assert table["index"].to_pylist() == list(range(data.frames))
    assert table["episode_index"].to_pylist() == data.episode_of.tolist()
    progress = table["progress_sparse"].to_numpy()
    means = {True: [], False: []}
    for segment in decided_segments(data, np.arange(data.episodes)):
        begins = np.arange(segment.start - CHUNK + 1, segment.stop - CHUNK)  # chunks that reach into it and not behind
        means[segment.elegant].append(np.mean(progress[begins + CHUNK] - progress[begins] > 0.01))  # which weigh 1
    assert np.mean(means[True]) > 0.9
    assert np.mean(means[False]) < 0.1


def test_an_episode_without_a_label_stands_still(tmp_path, make_toy, features):
    train(make_toy(), tmp_path / "run", TINY, features_dir=features)
    rng = np.random.default_rng(0)
    numbers = [rng.normal(size=(30, 3)) for _ in range(2)]
    episodes = [
        Recorded(n, n, np.zeros(30), np.full(30, known)) for n, known in zip(numbers, (True, False), strict=True)
    ]
    dataset = write_elegant(tmp_path / "other", episodes)
    curate(dataset, "--weights-from", tmp_path / "run")
    progress = pq.read_table(dataset / "sarm_progress.parquet")["progress_sparse"].to_numpy()
    assert np.ptp(progress[:30]) > 0
    assert np.ptp(progress[30:]) == 0


def test_a_dataset_is_made_and_weighed_by_one_command(tmp_path, features):
    good, bad = [(5, 14, 1)], [(5, 14, 0)]
    demos = write_picks(tmp_path / "demos", [good, bad] * 3)
    curated(demos, out=tmp_path / "d")
    few = Settings(TINY.data, TINY.network, TINY.loss, TINY.optimizer, RunSettings(steps=2, batch=4, device="cpu"))
    train(tmp_path / "d", tmp_path / "run", few, features_dir=features)
    said = curate(demos, "--out", tmp_path / "e", "--weights-from", tmp_path / "run", "--report")
    assert f"Weights for lerobot-train: {tmp_path / 'e' / 'sarm_progress.parquet'}" in said
    assert f"Report: {tmp_path / 'e' / 'meta' / 'jiti' / 'report.html'}" in said
    frames = read_elegant(tmp_path / "e").frames
    assert len(pq.read_table(tmp_path / "e" / "sarm_progress.parquet")) == frames
    curate(tmp_path / "d", "--weights-from", tmp_path / "run")  # which is there
    one, other = (pq.read_table(tmp_path / name / "sarm_progress.parquet") for name in "de")
    assert one.equals(other)


def test_a_run_that_does_not_fit_is_told(toy, tmp_path, features):
    demos = write_picks(tmp_path / "demos", [[(5, 14, 1)]])
    with pytest.raises(SourceError, match="is no critic"):
        curate(demos, "--out", tmp_path / "d", "--weights-from", tmp_path / "nowhere")
    assert not (tmp_path / "d").exists()
    few = Settings(TINY.data, TINY.network, TINY.loss, TINY.optimizer, RunSettings(steps=2, batch=4, device="cpu"))
    train(toy, tmp_path / "run", few, features_dir=features)
    with pytest.raises(SourceError, match="this critic takes 1 x 3 and 3"):
        curate(demos, "--out", tmp_path / "d", "--weights-from", tmp_path / "run")
    assert (tmp_path / "d").is_dir()
    with pytest.raises(SourceError, match="is no LeRobot dataset"):
        curate(demos, "--weights-from", tmp_path / "run")
    with pytest.raises(UsageError, match="is of one dataset"):
        curate(tmp_path / "d", tmp_path / "d", "--weights-from", tmp_path / "run")
    with pytest.raises(UsageError, match="pass one of them"):
        curate(demos, "--out", tmp_path / "d", "--weights", "--weights-from", tmp_path / "run")
