"""Ranking by hand, calibration of what is calibrated, and the whole evaluation from the command line."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from jiti.cli import app
from jiti.critic.calibration import calibration
from jiti.critic.dataset import read_elegant
from jiti.critic.evaluate import evaluate, swapped_pairs
from jiti.critic.features.cache import feature_cache
from jiti.critic.ranking import Decided, area_under_curve, decided_segments, frames_scored, rank, shuffled_rewards
from jiti.critic.settings_file import settings_from
from jiti.critic.train import train
from jiti.errors import JitiError, UsageError
from tests.critic.conftest import toy_episode
from tests.critic.elegant import write_elegant

TOML = """
[network]
width = 16
heads = 2
actor_width = 16
chunk = 4
[loss]
td_offset = 4
alpha = 1.0
[optimizer]
critic_lr = 3e-3
[run]
batch = 16
check_every = 30
log_every = 10
"""


def test_auc_is_the_share_of_pairs_in_the_right_order():
    scores, positive = np.array([3.0, 1.0, 2.0, 1.0]), np.array([True, True, False, False])
    assert area_under_curve(scores, positive) == (2 + 0 + 0.5) / 4
    segments = [Decided(0, "a", 0, 1, True), Decided(1, "a", 1, 2, False), Decided(2, "b", 2, 3, True)]
    ranking = rank(np.array([1.0, 2.0, 9.0]), segments)
    assert ranking.auc == {"a": 0.0}
    assert ranking.counts == {"a": (1, 1), "b": (1, 0)}


def test_decided_segments_are_those_of_the_labels(toy):
    data = read_elegant(toy)
    segments = decided_segments(data, np.arange(data.episodes))
    assert [(s.start - data.offsets[s.episode], s.stop - data.offsets[s.episode]) for s in segments] == [(20, 30)] * 24
    assert [s.elegant for s in segments] == [True, False] * 12


def test_only_frames_where_a_whole_chunk_fits_count(toy):
    data = read_elegant(toy)
    assert frames_scored(data, Decided(0, "a", 33, 40, True), 4).tolist() == [33, 34, 35, 36]
    assert frames_scored(data, Decided(0, "a", 38, 40, True), 4).tolist() == [38, 39]


def test_verdicts_are_dealt_anew_within_tasks(toy):
    data = read_elegant(toy)
    other = data.with_rewards(shuffled_rewards(data, seed=1), data.gamma)
    assert not np.array_equal(other.reward, data.reward)
    before, after = (decided_segments(d, np.arange(d.episodes)) for d in (data, other))
    for task in ("toy/0", "toy/1"):
        assert sum(s.elegant for s in before if s.task == task) == sum(s.elegant for s in after if s.task == task)


def test_a_q_that_is_the_return_is_calibrated():
    returns = np.random.default_rng(0).uniform(0, 5, 1000)
    found = calibration(returns, returns)
    assert (found.bias, found.rmse, found.frames) == (0, 0, 1000)
    assert found.correlation == pytest.approx(1)
    assert found.bins_q == found.bins_return
    shifted = calibration(returns - 2, returns)
    assert shifted.bias == pytest.approx(-2)
    assert sum(shifted.bins_count) == 1000


def test_train_and_evaluate_from_the_command_line(toy, monkeypatch):
    folder = toy.parent
    (folder / "run.toml").write_text(TOML)
    where = ["--cache", str(folder / "features")]
    line = ["train-critic", str(toy), "--out", str(folder / "run"), "--config", str(folder / "run.toml"), *where]
    trained = CliRunner().invoke(app, [*line, "--steps", "90"], catch_exceptions=False)
    assert trained.exit_code == 0
    assert "Trained to step 90" in trained.output
    shown = []
    monkeypatch.setattr(
        "jiti.critic.evaluate.show_episode", lambda _critic, _data, _cache, episode, _folder: shown.append(episode)
    )
    line = ["train-critic", "--evaluate", str(folder / "run"), "--json", *where]
    said = CliRunner().invoke(app, line, catch_exceptions=False)
    found = json.loads(said.stdout)
    assert found == json.loads((folder / "run/evaluation/evaluation.json").read_text())
    assert found["auc"]["0 frames before"]["average"] == 1.0
    assert set(found["auc"]["0 frames before"]["tasks"]) == {"toy/0", "toy/1"}
    assert found["auc_with_chunks_swapped"]["average"] < 1.0
    assert 0 <= found["bound_active"]["test"] <= 1
    assert (folder / "run/evaluation/calibration.png").read_bytes().startswith(b"\x89PNG")
    assert len(shown) == 2
    text = CliRunner().invoke(app, [*line[:3], *where], catch_exceptions=False).output
    assert "1.00  average of 2 tasks" in text
    with pytest.raises(JitiError, match="has no labelled episode"):
        CliRunner().invoke(app, [*line, "--split", "unseen"], catch_exceptions=False)


@pytest.fixture
def trained(toy, monkeypatch):
    """A run of two steps with another discount than its dataset's; nothing is drawn for Rerun."""
    settings = settings_from(
        {
            "data": {"gamma": 0.5},
            "network": {"width": 16, "heads": 2, "actor_width": 16, "chunk": 4},
            "run": {"steps": 2, "batch": 16, "device": "cpu"},
        }
    )
    train(toy, toy.parent / "run", settings, features_dir=toy.parent / "features")
    monkeypatch.setattr("jiti.critic.evaluate.show_episode", lambda *_: None)
    return toy.parent / "run"


def test_what_was_learned_from_is_not_taken_for_held_out(toy, trained):
    where = {"features_dir": toy.parent / "features"}
    assert evaluate(trained, **where).episodes == 8
    assert evaluate(trained, split="train", **where).episodes == 12
    path = toy / "meta/jiti/episodes.parquet"
    table = pq.read_table(path)
    splits = pa.array(["test"] * 2 + ["train"] * 22)
    pq.write_table(table.set_column(table.column_names.index("split"), "split", splits), path)
    with pytest.raises(UsageError, match="has 2 episodes that the critic learned from, the first recorded_0: "):
        evaluate(trained, **where)
    assert evaluate(trained, split="train", **where).episodes == 22
    with pytest.raises(UsageError, match=r"--split all of .* has 12 episodes that the critic learned from"):
        evaluate(trained, split="all", **where)


def test_all_of_another_dataset_is_held_out(toy, trained):
    rng = np.random.default_rng(9)
    episodes = [toy_episode(rng, elegant=n % 2 == 0, task="toy/0", split="train") for n in range(4)]
    other = write_elegant(toy.parent / "other", episodes)
    assert evaluate(trained, other, split="all", features_dir=toy.parent / "features").episodes == 4


def test_a_run_is_evaluated_with_its_own_discount_device_and_as_many_workers_as_asked(toy, trained, monkeypatch):
    asked = {}

    def noted(data, name, **options):
        asked.update(options, gamma=data.gamma)
        return feature_cache(data, name, **(options | {"workers": 1}))

    monkeypatch.setattr("jiti.critic.evaluate.feature_cache", noted)
    where = ["--cache", str(toy.parent / "features"), "--workers", "2"]
    line = ["train-critic", "--evaluate", str(trained), *where]
    assert CliRunner().invoke(app, line, catch_exceptions=False).exit_code == 0
    assert (asked["gamma"], asked["device"], asked["workers"]) == (0.5, "cpu", 2)
    path = trained / "config.json"
    config = json.loads(path.read_text())
    config["settings"]["run"]["device"] = "meta"
    config["settings"]["data"] = {}
    path.write_text(json.dumps(config))
    with pytest.raises((NotImplementedError, RuntimeError)):  # torch computes nothing on that device
        evaluate(trained, features_dir=toy.parent / "features")
    assert (asked["gamma"], asked["device"]) == (0.5, "meta")


def test_swapped_chunks_are_of_another_episode_of_the_task():
    def segment(episode, task):
        return Decided(episode, task, 10 * episode, 10 * episode + 5, True)

    several = [segment(e, "a") for e in (0, 0, 0, 1, 2, 2)]
    alone = [segment(7, "b"), segment(7, "b")]
    for seed in range(20):
        pairs = swapped_pairs([*several, *alone], seed)
        assert sorted(here.episode for here, _ in pairs) == [0, 0, 0, 1, 2, 2]
        assert all(here.episode != other.episode and here.task == other.task for here, other in pairs)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "needs a dataset"),
        (["data"], "--out RUN is missing"),
        (["data", "--out", "run", "--episode", "1"], "--episode is of --evaluate"),
        (["data", "--out", "run", "--split", "train"], "--split is of --evaluate"),
        (["--evaluate", "run", "--steps", "5"], "--steps is of training"),
        (["--evaluate", "run"], "is no critic"),
    ],
)
def test_arguments_that_do_not_fit_are_answered(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(JitiError, match=message):
        CliRunner().invoke(app, ["train-critic", *arguments], catch_exceptions=False)
