"""Training: learns a toy, goes on exactly as if it had not been stopped, and refuses what does not fit."""

import json
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch  # noqa: TID253  these tests are about tensors
from safetensors.torch import load_file

from jiti.critic.checkpoint import checkpoints
from jiti.critic.critic import load_critic
from jiti.critic.dataset import read_elegant
from jiti.critic.features import open_extractor
from jiti.critic.features.cache import FeatureCache
from jiti.critic.settings import Settings
from jiti.critic.settings_file import settings_from
from jiti.critic.stop import asked_to_stop
from jiti.critic.train import train
from jiti.durable import write_atomic
from jiti.errors import JitiError, SaveFailed, SourceError, UsageError

SMALL = {
    "network": {"width": 16, "heads": 2, "actor_width": 16, "chunk": 4},
    "loss": {"td_offset": 4, "alpha": 1.0},
    "optimizer": {"critic_lr": 3e-3, "actor_lr": 1e-3},
    "run": {"batch": 16, "check_every": 2, "log_every": 1, "device": "cpu"},
}


def small(steps: int, **sections) -> Settings:
    merged = {name: {**SMALL.get(name, {}), **sections.get(name, {})} for name in {*SMALL, *sections}}
    made = settings_from(merged)
    return replace(made, run=replace(made.run, steps=steps))


def run(toy: Path, name: str, settings: Settings, **options):
    return train(toy, toy.parent / name, settings, features_dir=toy.parent / "features", **options)


def files(folder: Path) -> dict[str, dict[str, torch.Tensor]]:
    return {name: load_file(folder / name) for name in ("model.safetensors", "training.safetensors")}


def same(one: dict, other: dict) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"loss": {"lagrange": True, "variant": "public", "backup": "max", "backup_chunks": 2}},
        {"loss": {"alpha": 0.0}, "data": {"gamma": 0.9}},
    ],
)
def test_two_steps_and_two_more_are_four_steps_bit_for_bit(toy, sections):
    run(toy, "whole", small(4, **sections))
    run(toy, "parts", small(2, **sections))
    run(toy, "parts", small(4, **sections))
    whole, parts = checkpoints(toy.parent / "whole")[0], checkpoints(toy.parent / "parts")[0]
    assert whole.name == parts.name == "step-00000004"
    for name, tensors in files(whole).items():
        assert same(tensors, files(parts)[name]), name
    assert (whole / "training.json").read_bytes() == (parts / "training.json").read_bytes()
    told = [pq.read_table(toy.parent / name / "metrics").sort_by("step").to_pylist() for name in ("whole", "parts")]
    assert told[0] == told[1]
    assert {row["step"] for row in told[0]} == {1, 2, 3, 4}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_stop_keeps_the_step_and_the_run_goes_on_bit_for_bit(toy, number):
    before = signal.getsignal(number)

    def stop(_share: float, said: str) -> None:
        if said.startswith("step 3 "):
            signal.raise_signal(number)

    run(toy, "whole", small(6, run={"check_every": 4}))
    with pytest.raises(KeyboardInterrupt, match="step 3 is kept"):
        run(toy, "parts", small(6, run={"check_every": 4}), progress=stop)
    assert signal.getsignal(number) == before
    assert [folder.name for folder in checkpoints(toy.parent / "parts")] == ["step-00000003"]
    done = run(toy, "parts", small(6, run={"check_every": 4}))
    assert (done.step, done.steps) == (6, 3)
    whole, parts = (checkpoints(toy.parent / name)[0] for name in ("whole", "parts"))
    assert all(same(tensors, files(parts)[name]) for name, tensors in files(whole).items())
    told = [pq.read_table(toy.parent / name / "metrics").sort_by("step").to_pylist() for name in ("whole", "parts")]
    assert told[0] == told[1]


def test_a_second_signal_to_stop_interrupts_at_once():
    with asked_to_stop() as asked:
        signal.raise_signal(signal.SIGINT)
        assert asked.to_stop
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_run_that_had_ended_says_so(toy):
    run(toy, "run", small(2))
    assert "had come to step 2" in str(run(toy, "run", small(2)))
    assert "Nothing was done; more --steps go on there." in str(run(toy, "run", small(2)))


def test_seeds_differ_and_a_seed_repeats(toy):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        run(toy, name, small(2, run={"seed": seed}))
    a, b, c = (load_file(toy.parent / name / "model.safetensors") for name in "abc")
    assert same(a, b)
    assert not same(a, c)


def test_a_toy_is_learned_and_training_ends_when_it_does_not_become_better(toy):
    done = run(toy, "run", small(400, run={"check_every": 20, "patience": 3, "log_every": 10}))
    assert done.best["auc"] == 1.0
    assert done.stopped_early
    assert done.step < 400
    told = pq.read_table(toy.parent / "run" / "metrics").to_pylist()
    ranked = {row["step"]: row["value"] for row in told if row["name"] == "validation/auc"}
    assert done.best["step"] == max(step for step, auc in ranked.items() if auc == 1.0) > min(ranked)
    again = run(toy, "run", small(400, run={"check_every": 20, "patience": 3, "log_every": 10}))
    assert again.step == done.step


def test_validation_of_one_kind_of_verdict_has_no_ranking(toy):
    data = read_elegant(toy)
    one_kind = np.where((data.split == "validation") & (np.arange(data.episodes) % 2 == 0), "test", data.split)
    done = run(toy, "run", small(4), data=data.with_splits(one_kind))
    assert done.best.keys() == {"bellman", "step"}
    assert "no task of validation has verdicts of both kinds" in str(done)
    about = (toy.parent / "run/config.json").read_text()
    assert json.loads(about)["validation"].keys() == {"bellman"}
    assert run(toy, "run", small(6), data=data.with_splits(one_kind)).step == 6


def test_the_greatest_seed_works_and_no_greater_one(toy):
    assert run(toy, "run", small(2, run={"seed": 2**32 - 1})).step == 2
    with pytest.raises(UsageError, match=r"run\.seed is 4294967296; it must be from 0 to 4294967295"):
        small(2, run={"seed": 2**32})


@pytest.mark.parametrize(("keep", "file"), [("target", "training.safetensors"), ("online", "model.safetensors")])
def test_a_run_keeps_the_average_of_q_or_q_itself(toy, keep, file):
    run(toy, "run", small(2, run={"keep": keep}))
    kept = load_file(toy.parent / "run/model.safetensors")
    prefix = "target." if keep == "target" else "q."
    last = load_file(checkpoints(toy.parent / "run")[0] / file)
    assert all(
        torch.equal(last[prefix + name.removeprefix("q.")], kept[name]) for name in kept if name.startswith("q.")
    )
    other = load_file(checkpoints(toy.parent / "run")[0] / "model.safetensors")
    assert (keep == "online") == all(torch.equal(other[name], kept[name]) for name in kept)


def test_what_is_kept_values_chunks_in_the_recordings_units(toy):
    run(toy, "run", small(2))
    critic, data = load_critic(toy.parent / "run"), read_elegant(toy)
    chunks = data.action[:4][None, None].repeat(2, 1)
    values = critic.values(torch.zeros(1, 1, 3), chunks)
    assert values.shape == (2, 1, 2)
    torch.testing.assert_close(values[:, :, 0], values[:, :, 1])
    assert critic.config["dataset"]["fingerprint"] == data.fingerprint
    assert critic.config["dataset"]["tasks"] == sorted(set(data.task[data.of_split("train")]))
    assert critic.config["extractor"]["name"] == "state"
    assert not list((toy.parent / "run").rglob("*.pt")) + list((toy.parent / "run").rglob("*.pkl"))
    with pytest.raises(SourceError, match=r"values chunks of \(4, 3\).*it was given \(5, 3\)"):
        critic.values(torch.zeros(1, 1, 3), np.zeros((1, 1, 5, 3), np.float32))


def test_a_run_goes_on_only_with_its_own_settings(toy):
    run(toy, "run", small(2))
    with pytest.raises(UsageError, match=r"another loss\.alpha \(1\.0 there, 2\.0 asked for\)\. Name"):
        run(toy, "run", small(4, loss={"alpha": 2.0}))
    (toy.parent / "mine").mkdir()
    (toy.parent / "mine/notes.txt").write_text("keep")
    with pytest.raises(UsageError, match="is not empty"):
        run(toy, "mine", small(2))


def test_normalization_and_looks_see_all_of_a_split(toy, monkeypatch):
    monkeypatch.setattr("jiti.critic.train.FIT_FRAMES", 300)
    monkeypatch.setattr("jiti.critic.train.LOOK_FRAMES", 100)
    read, seen = FeatureCache.read, []
    monkeypatch.setattr(FeatureCache, "read", lambda cache, frames: seen.append(frames) or read(cache, frames))
    run(toy, "run", small(2))
    assert (len(seen[0]), seen[0][0], seen[0][-1]) == (300, 0, 12 * 40 - 1)
    looked = next(frames for frames in seen if len(frames) == 100)
    assert (looked[0], looked[-1]) == (12 * 40, 16 * 40 - 1)


def change_rewards(toy: Path) -> Path:
    path = toy / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    other = pa.array(1 - table["next.reward"].to_numpy())
    pq.write_table(table.set_column(table.column_names.index("next.reward"), "next.reward", other), path)
    return toy


def other_weights(*arguments, **options):
    made: Any = open_extractor(*arguments, **options)
    made.fingerprint = "ab" * 32
    return made


def test_a_run_goes_on_only_with_its_own_data_and_features(toy, monkeypatch):
    data = read_elegant(toy)
    run(toy, "run", small(2))
    with pytest.raises(UsageError, match="another choice of training episodes"):
        run(toy, "run", small(4), data=data.with_splits(np.roll(data.split, 12)))
    (toy / "meta/jiti/curate.json").write_text(json.dumps({"gamma": 0.5}))
    with pytest.raises(UsageError, match="holds a run with another discount"):
        run(toy, "run", small(4))
    (toy / "meta/jiti/curate.json").write_text(json.dumps({"gamma": 0.98}))
    with monkeypatch.context() as changed:
        changed.setattr("jiti.critic.features.cache.open_extractor", other_weights)
        with pytest.raises(UsageError, match="another features"):
            run(toy, "run", small(4))
    assert run(toy, "run", small(4)).step == 4
    with pytest.raises(UsageError, match=r"another dataset \(its frames, labels or videos\)\. Name another folder"):
        run(change_rewards(toy), "run", small(6))


def test_a_run_that_goes_on_keeps_its_range_of_actions(toy):
    run(toy, "run", small(2))
    path = checkpoints(toy.parent / "run")[0] / "config.json"
    config = json.loads(path.read_text())
    config["action_low"][0] = -7.0
    path.write_text(json.dumps(config))
    run(toy, "run", small(4))
    assert load_critic(checkpoints(toy.parent / "run")[0]).limits.low[0] == -7


def test_a_run_of_before_goes_on_without_what_it_does_not_say(toy):
    run(toy, "run", small(2))
    path = checkpoints(toy.parent / "run")[0] / "config.json"
    config = json.loads(path.read_text())
    del config["dataset"]["train"]
    path.write_text(json.dumps(config))
    assert run(toy, "run", small(4)).step == 4


def test_a_checkpoint_of_other_sizes_is_refused(toy):
    run(toy, "run", small(2))
    folder = checkpoints(toy.parent / "run")[0]
    config = json.loads((folder / "config.json").read_text())
    config["network"]["width"] = 32
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(SourceError, match=r"does not fit: .* has size .* and size "):
        load_critic(folder)


def test_nothing_to_tell_apart_is_refused(toy):
    data = read_elegant(toy)
    only = data.with_rewards(np.where(data.annotated, 1.0, 0.0), data.gamma)
    with pytest.raises(SourceError, match="every decided segment of split train is satisfied"):
        run(toy, "run", small(2), data=only)
    with pytest.raises(SourceError, match="no labelled episode is in split train"):
        run(toy, "run", small(2), data=data.with_splits(np.full(data.episodes, "test")))


def test_a_full_disk_leaves_the_last_checkpoint_whole(toy, monkeypatch):
    run(toy, "run", small(2))
    before = files(checkpoints(toy.parent / "run")[0])

    def full(path, data):
        if path.name == "training.json":
            raise SaveFailed(f"{path} could not be saved")
        write_atomic(path, data)

    monkeypatch.setattr("jiti.critic.checkpoint.write_atomic", full)
    with pytest.raises(JitiError, match="could not be saved"):
        run(toy, "run", small(4))
    (left,) = (toy.parent / "run/checkpoints").iterdir()
    assert left.name == "step-00000002"
    for name, tensors in files(left).items():
        assert same(tensors, before[name])
