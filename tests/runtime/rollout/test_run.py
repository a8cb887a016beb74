"""Rollouts: the same states and noise for every guidance, whole or not at all, gone on with, never mixed."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from jiti.annotate.simulator import propose_from_simulator
from jiti.annotate.web.session import open_session
from jiti.episodes.episode import numbers
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError, UsageError
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout import run as run_module
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.runtime.rollout.plan_file import enter_plan
from jiti.runtime.rollout.result import load_result
from jiti.runtime.rollout.run import all_rollouts, run_rollouts
from jiti.runtime.sim.record import recorded_metadata
from tests.builders import rollout_agents
from tests.builders.rollout_agents import wandering
from tests.runtime.rollout.conftest import FULL, JITI, NONE, STEPS, TASK, write_critic, write_policy

sim = pytest.mark.sim


def messages(path):
    with path.open("rb") as file:
        return [(channel.topic, m.log_time, m.data) for _, channel, m in make_reader(file).iter_messages()]


def decided(rollouts):
    """All of decisions that is not time."""
    return [[(c.decision, c.frame, str(c.q_t), c.triggered, c.values, c.chosen) for c in r.choices] for r in rollouts]


def actions(path) -> np.ndarray:
    reader = open_reader(path)
    return numbers(reader.open(reader.episodes()[0].episode_id), "/action")[1]


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Two episodes of each of three guidances, and their folder."""
    folder = tmp_path_factory.mktemp("played")
    policy, critic = write_policy(folder / "policy"), write_critic(folder / "critic")
    plan = RolloutPlan(TASK, str(policy), str(critic), (NONE, JITI, FULL), seed=7, most_steps=STEPS)
    shares: list[float] = []
    out = folder / "out"
    rollouts = run_rollouts(
        plan, out, episodes=2, workers=1, make_agent=wandering, progress=lambda share, _what: shares.append(share)
    )
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    return plan, out, rollouts


@sim
def test_each_episode_is_a_row_a_recording_and_its_decisions(played):
    _, out, rollouts = played
    assert [(r.label, r.seed) for r in rollouts] == [(m, s) for m in ("none", "jiti", "full") for s in (7, 8)]
    rows = pq.read_table(out / "rollouts.parquet").to_pylist()
    assert {(r["label"], r["seed"], r["task"]) for r in rows} == {(r.label, r.seed, "elegant/T2") for r in rollouts}
    plan = json.loads((out / "plan.json").read_text())
    critic = plan["methods"]["jiti"]["critic"]
    assert {(r["label"], r["policy"], r["critic"]) for r in rows} == {
        (label, plan["shared"]["policy"], asked)
        for label, asked in (("none", None), ("jiti", critic), ("full", critic))
    }
    assert all(r["steps"] == STEPS + 1 and r["cut_off"] and not r["success"] for r in rows)
    assert {v["itc"] for r in rows for v in r["itcs"]} == {TASK.itcs[0].itc_id}
    decisions = pq.read_table(out / "decisions.parquet").to_pylist()
    assert [d["frame"] for d in decisions if (d["label"], d["seed"]) == ("full", 8)] == [0, 10, 20, 30, 40]
    assert all(d["q_t"] is None for d in decisions if d["label"] == "none")
    assert all(len(d["values"]) == 4 for d in decisions if d["label"] == "full")
    assert sum(r["interventions"] for r in rows if r["label"] == "full") == 10
    assert decided(all_rollouts(out)) == decided(sorted(rollouts, key=lambda r: (r.label, r.seed)))
    told = json.loads((out / "plan.json").read_text())
    assert told["shared"]["seed"] == 7
    assert told["methods"]["jiti"]["tau"] == 1.0
    assert told["runs"][0]["hardware"]["cores"] >= 1
    assert {"jiti", "mujoco", "numpy"} <= told["runs"][0]["versions"].keys()


@sim
def test_every_guidance_begins_at_the_same_state_with_the_same_default(played):
    plan, out, rollouts = played
    for seed in (7, 8):
        first = [messages(out / label / f"elegant-T2_{seed:04d}.mcap") for label in plan.labels]
        starts = [[m for m in part if m[1] == part[0][1] and m[0].startswith("/objects")] for part in first]
        assert starts[0] == starts[1] == starts[2]
        jiti, full = (next(r for r in rollouts if (r.label, r.seed) == (label, seed)) for label in ("jiti", "full"))
        assert jiti.choices[0].q_t == full.choices[0].q_t
    assert messages(out / "none/elegant-T2_0007.mcap") != messages(out / "none/elegant-T2_0008.mcap")


@sim
def test_with_one_candidate_all_guidances_are_one(plan, tmp_path):
    alone = replace(plan, guidances=(NONE, Guidance("jiti", candidates=1, tau=0.0), Guidance("full", candidates=1)))
    run_rollouts(alone, tmp_path / "out", episodes=1, workers=1, make_agent=wandering)
    done = [actions(tmp_path / "out" / label / "elegant-T2_0007.mcap") for label in alone.labels]
    assert done[0].shape == (STEPS, 7)
    np.testing.assert_array_equal(done[0], done[1])
    np.testing.assert_array_equal(done[0], done[2])


@sim
def test_a_guidance_changes_nothing_before_its_first_intervention(played):
    _, out, rollouts = played
    for seed in (7, 8):
        jiti = next(r for r in rollouts if (r.label, r.seed) == ("jiti", seed))
        changed = next((c.frame for c in jiti.choices if c.chosen), STEPS)
        a, b = (actions(out / label / f"elegant-T2_{seed:04d}.mcap") for label in ("none", "jiti"))
        np.testing.assert_array_equal(a[:changed], b[:changed])
        if changed < STEPS:
            assert not np.array_equal(a[changed : changed + 10], b[changed : changed + 10])


@sim
def test_a_recording_opens_in_the_annotator_and_the_simulator_judges_it(played):
    _, out, rollouts = played
    session = open_session(str(out), annotator="ada", labels=None, tasks=None)
    refs = session.reader.episodes()
    assert [ref.title for ref in refs] == sorted(f"{r.label}/elegant-T2_{r.seed:04d}.mcap" for r in rollouts)
    by_title = {f"{r.label}/elegant-T2_{r.seed:04d}.mcap": r for r in rollouts}
    for ref in refs:
        episode, rollout = session.reader.open(ref.episode_id), by_title[ref.title]
        assert not episode.problems
        assert session.task(episode) == TASK
        assert episode.clock.frame_count == rollout.steps
        (segment,) = propose_from_simulator(episode, TASK)
        ((_, verdict),) = rollout.itcs
        assert segment.reward == int(verdict.satisfied)
        assert f"Decided at frame {verdict.step}." in segment.rationale
        time_ns, values = numbers(episode, "/decisions")
        assert episode.streams["/decisions"].names == ("q_t", "q_bar", "delta_q", "triggered", "chosen")
        frames = np.searchsorted(episode.clock.frame_ns, time_ns)
        assert frames.tolist() == [c.frame for c in rollout.choices]
        assert values[:, 3].astype(bool).tolist() == [c.triggered for c in rollout.choices]
        assert values[:, 4].tolist() == [c.chosen for c in rollout.choices]
        np.testing.assert_array_equal(values[:, 0], [c.q_t for c in rollout.choices])
    about = recorded_metadata(out / "jiti/elegant-T2_0007.mcap")
    assert (about["task"], about["seed"], about["guidance"], about["tau"]) == ("elegant/T2", "7", "jiti", "1")
    assert {"policy", "critic", "outcome", "steps"} <= about.keys()
    assert str(out.parent) not in str(about)


@sim
def test_autolabel_takes_rollouts_from_the_simulator_and_a_folder_above_leaves_them_alone(played, tmp_path):
    from jiti.annotate.autolabel import autolabel
    from jiti.annotate.proposer import Proposer

    _, out, rollouts = played
    copied = tmp_path / "demos" / "rollouts" / "elegant-T2"
    shutil.copytree(out, copied)
    reader = open_reader(copied)
    done = autolabel(reader, Proposer(str(copied), copied / "labels", by="sim"))
    assert done.proposals == len(rollouts)
    with pytest.raises(SourceError, match=r"found rollouts in rollouts/elegant-T2\. Open one of them"):
        open_reader(tmp_path / "demos")
    shutil.copy(out / "none/elegant-T2_0007.mcap", tmp_path / "demos")
    assert [r.title for r in open_reader(tmp_path / "demos").episodes()] == ["elegant-T2_0007.mcap"]


@sim
def test_a_second_run_takes_what_is_there_and_plays_what_is_not(played, tmp_path):
    plan, out, rollouts = played
    again = tmp_path / "again"
    shutil.copytree(out, again)
    (again / "jiti/elegant-T2_0008.json").unlink()  # as where it was killed after the recording was closed
    (again / "full/elegant-T2_0007.mcap").unlink()
    (again / "full/.tmp-12-ab-elegant-T2_0007.mcap").write_bytes(b"half")
    kept = (again / "none/elegant-T2_0007.json").stat().st_mtime_ns
    played_now: list[str] = []
    second = run_rollouts(
        plan, again, episodes=2, workers=1, make_agent=wandering, progress=lambda _share, what: played_now.append(what)
    )
    assert played_now == ["2 episodes to play", "played full elegant-T2_0007", "played jiti elegant-T2_0008"]
    assert decided(second) == decided(rollouts)
    assert (again / "none/elegant-T2_0007.json").stat().st_mtime_ns == kept
    for label in plan.labels:
        for seed in (7, 8):
            name = f"{label}/elegant-T2_{seed:04d}.mcap"
            assert messages(again / name) == messages(out / name)
    assert not list(again.glob("*/.tmp-*"))
    assert len(json.loads((again / "plan.json").read_text())["runs"]) == 2


@sim
def test_more_episodes_and_other_guidances_join_those_that_are_there(played, tmp_path):
    plan, out, _ = played
    again = tmp_path / "again"
    shutil.copytree(out, again)
    other = replace(plan, guidances=(Guidance("jiti", "random", tau=1.0),))
    more = run_rollouts(other, again, episodes=1, workers=1, make_agent=wandering)
    assert [(r.label, r.seed) for r in more] == [("jiti-random", 7)]
    assert {r.label for r in all_rollouts(again)} == {"none", "jiti", "full", "jiti-random"}
    assert len(pq.read_table(again / "rollouts.parquet")) == 7


def test_a_folder_takes_no_rollouts_of_another_plan(played, tmp_path):
    plan, out, _ = played
    other_critic = write_critic(tmp_path / "critic", b"other weights")
    other_policy = write_policy(tmp_path / "policy", b"other weights")
    cases = {
        "policy": replace(plan, policy=str(other_policy)),
        "jiti critic": replace(plan, critic=str(other_critic)),
        "seed 7 and not 9": replace(plan, seed=9),
        "most_steps 45 and not 46": replace(plan, most_steps=46),
        "device 'cpu' and not 'cuda'": replace(plan, device="cuda"),
        "start 'jitter' and not 'file'": replace(plan, start="file"),
        r"jiti tau 1\.0 and not 2\.0": replace(plan, guidances=(Guidance("jiti", tau=2.0),)),
        r"with task 'elegant/T2' and not 'elegant/T0'\.": replace(plan, task=_task("elegant/T0")),
    }
    before = (out / "plan.json").read_bytes()
    for said, wanted in cases.items():
        with pytest.raises(UsageError, match=f"{said}.*--out"):
            run_rollouts(wanted, out, episodes=1, workers=1, make_agent=wandering)
    # What none plays does not depend on a critic.
    kept = replace(plan, guidances=(NONE,), critic=str(other_critic))
    assert len(run_rollouts(kept, out, episodes=1, workers=1, make_agent=wandering)) == 1
    assert json.loads((out / "plan.json").read_text())["shared"] == json.loads(before)["shared"]


def test_a_plan_of_which_nothing_was_played_does_not_bind_its_folder(plan, played, tmp_path):
    other = replace(plan, critic=str(write_critic(tmp_path / "other", b"other weights")), seed=9)
    enter_plan(tmp_path, other)
    (tmp_path / "none").mkdir()
    (tmp_path / "none/.tmp-12-ab-elegant-T2_0009.mcap").touch()
    told = enter_plan(tmp_path, replace(plan, guidances=(NONE, JITI)))
    assert (told["shared"]["seed"], list(told["methods"]), len(told["runs"])) == (7, ["none", "jiti"], 1)
    # Where a guidance was played, what is shared binds, and its settings, but not those of one that was not played.
    (tmp_path / "none/elegant-T2_0007.mcap").touch()
    with pytest.raises(UsageError, match="seed 7 and not 9"):
        enter_plan(tmp_path, other)
    told = enter_plan(tmp_path, replace(other, seed=7, guidances=(FULL, replace(JITI, tau=2.0))))
    assert list(told["methods"]) == ["none", "full", "jiti"]
    assert told["methods"]["jiti"]["tau"] == 2.0
    # Rollouts that are there are still compared with.
    with pytest.raises(UsageError, match=r"jiti tau 1\.0 and not 2\.0"):
        enter_plan(played[1], replace(played[0], guidances=(replace(JITI, tau=2.0),)))


def test_folders_in_which_each_run_has_its_device_are_gone_on_with(plan, tmp_path):
    enter_plan(tmp_path, plan)
    (tmp_path / "none").mkdir()
    (tmp_path / "none/elegant-T2_0007.json").touch()
    told = json.loads((tmp_path / "plan.json").read_text())
    told["runs"][0]["device"] = told["shared"].pop("device")
    (tmp_path / "plan.json").write_text(json.dumps(told, indent=2))
    assert enter_plan(tmp_path, plan)["shared"]["device"] == "cpu"
    with pytest.raises(UsageError, match="device 'cpu' and not 'cuda'"):
        enter_plan(tmp_path, replace(plan, device="cuda"))


def test_a_folder_is_of_one_scene_and_one_asset_pack_whatever_they_are_called(plan, tmp_path):
    packs = [tmp_path / name / "assets" for name in ("one", "other")]
    for place, pack in enumerate(packs):
        (pack / "scenes").mkdir(parents=True)
        (pack / "scenes" / "table.xml").write_bytes(b"x" * place)
    one = replace(plan, assets=str(packs[0]))
    enter_plan(tmp_path, one)
    (tmp_path / "none").mkdir()
    (tmp_path / "none/elegant-T2_0007.json").touch()
    with pytest.raises(UsageError, match=r"pack 'assets/ [0-9a-f]+' and not 'assets/ [0-9a-f]+'"):
        enter_plan(tmp_path, replace(plan, assets=str(packs[1])))
    other = replace(TASK, bddl="libero_goal/push_the_plate_to_the_front_of_the_stove")
    with pytest.raises(UsageError, match=r"bddl 'libero_goal/put_the_bowl.* and not 'libero_goal/push_the_plate"):
        enter_plan(tmp_path, replace(one, task=other))
    told = json.loads((tmp_path / "plan.json").read_text())
    for key in ("bddl", "pack"):  # as an older jiti wrote it
        del told["shared"][key]
    (tmp_path / "plan.json").write_text(json.dumps(told, indent=2))
    assert enter_plan(tmp_path, one)["shared"]["pack"].startswith("assets/ ")


def test_a_run_without_a_critic_leaves_the_one_that_guided_others(plan, tmp_path):
    out = tmp_path / "out"
    (out / "none").mkdir(parents=True)
    assert enter_plan(out, replace(plan, guidances=(NONE,), critic=None))["sources"]["critic"] is None
    (out / "none/elegant-T2_0007.json").touch()
    assert enter_plan(out, plan)["sources"]["critic"] == plan.critic
    for critic in (None, str(write_critic(tmp_path / "other", b"other weights"))):
        told = enter_plan(out, replace(plan, guidances=(NONE,), critic=critic))
        assert told["sources"] == {"policy": plan.policy, "critic": plan.critic}


def _task(task_id):
    from jiti.tasks.catalogue import load_catalogue

    return load_catalogue().task(task_id)


@pytest.mark.slow
@sim
def test_a_seed_gives_the_same_rollout_on_several_cores(played, tmp_path):
    plan, out, rollouts = played
    apart = run_rollouts(plan, tmp_path / "apart", episodes=2, workers=2, make_agent=wandering)
    assert decided(apart) == decided(rollouts)
    for path in out.glob("*/*.mcap"):
        assert messages(tmp_path / "apart" / path.relative_to(out)) == messages(path)


@pytest.mark.slow
@sim
def test_a_worker_that_is_killed_is_named_by_its_episode_and_nothing_is_lost(plan, critic, tmp_path):
    (critic / "armed").touch()
    out = tmp_path / "out"
    some = replace(plan, guidances=(NONE, FULL))
    with pytest.raises(UsageError, match=r"at work on full/elegant-T2_000\d \(seed \d\) was ended from outside"):
        run_rollouts(some, out, episodes=3, workers=2, make_agent=rollout_agents.killed)
    whole = [load_result(path) for path in out.glob("*/*.json")]
    assert len(pq.read_table(out / "rollouts.parquet")) == len(whole) < 6
    kept = {path: path.stat().st_mtime_ns for path in out.glob("*/*.json")}
    done = run_rollouts(some, out, episodes=3, workers=2, make_agent=rollout_agents.killed)
    assert len(done) == 6
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert not list(out.glob("*/.tmp-*"))


@sim
def test_a_critic_without_numbers_leaves_the_default_and_is_counted(plan, tmp_path):
    from jiti.runtime.rollout.summary import summarize

    some = replace(plan, guidances=(NONE, Guidance("jiti", tau=0.0)))
    rollouts = run_rollouts(some, tmp_path / "out", episodes=1, workers=1, make_agent=rollout_agents.without_numbers)
    quiet = rollouts[1]
    assert [bool(c.problem) for c in quiet.choices] == [False, False, True, True, True]
    np.testing.assert_array_equal(*(actions(tmp_path / "out" / m / "elegant-T2_0007.mcap") for m in ("none", "jiti")))
    assert summarize(rollouts)[1].problems == 3
    told = pq.read_table(tmp_path / "out/decisions.parquet").to_pylist()
    assert [d["q_t"] is None for d in told if d["problem"]] == [True] * 3


@sim
def test_actions_that_are_no_numbers_end_the_run_with_the_seed_and_leave_no_file(plan, tmp_path):
    with pytest.raises(UsageError, match="no number at step 0 of the episode with seed 7"):
        run_rollouts(plan, tmp_path / "out", episodes=1, workers=1, make_agent=rollout_agents.broken)
    assert not list((tmp_path / "out").glob("*/*"))


@sim
def test_what_stopped_a_run_is_told_and_not_that_its_tables_could_not_be_written(plan, tmp_path, monkeypatch):
    def stumble(_folder):
        raise AttributeError("a library was interrupted while it was imported")

    def stop(_share, what):
        if what.startswith("played"):
            raise KeyboardInterrupt

    monkeypatch.setattr(run_module, "tabulate", stumble)
    with pytest.raises(KeyboardInterrupt):
        run_rollouts(plan, tmp_path / "out", episodes=1, workers=1, make_agent=wandering, progress=stop)
    with pytest.raises(AttributeError):
        run_rollouts(plan, tmp_path / "out", episodes=1, workers=1, make_agent=wandering)


@pytest.mark.slow
@sim
def test_an_error_in_one_process_ends_all_and_is_told_as_it_is(plan, tmp_path):
    with pytest.raises(UsageError, match="no number at step 0 of the episode with seed"):
        run_rollouts(plan, tmp_path / "out", episodes=2, workers=2, make_agent=rollout_agents.broken)
    assert len(pq.read_table(tmp_path / "out/rollouts.parquet")) == 0


def test_what_cannot_be_played_is_said(plan, policy, tmp_path, monkeypatch):
    with pytest.raises(UsageError, match="needs a critic: pass --critic"):
        replace(plan, critic=None)
    with pytest.raises(UsageError, match="has no ITC"):
        replace(plan, task=replace(TASK, itcs=()))
    with pytest.raises(UsageError, match=r"centered has no `goal`"):
        replace(plan, task=replace(TASK, itcs=(replace(TASK.itcs[0], goal=""),)))
    with pytest.raises(UsageError, match="is not a task of simulation"):
        replace(plan, task=_task("so100/T0"))
    with pytest.raises(UsageError, match="asked for twice"):
        replace(plan, guidances=(JITI, JITI))
    with pytest.raises(UsageError, match="give 1 or more"):
        run_rollouts(plan, tmp_path / "out", episodes=0)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match=r"is no critic.*jiti train-critic"):
        run_rollouts(replace(plan, critic=str(tmp_path / "empty")), tmp_path / "out", episodes=1)
    with pytest.raises(UsageError, match=r"neither config\.json nor"):
        run_rollouts(replace(plan, policy=str(tmp_path / "empty")), tmp_path / "out", episodes=1)
    monkeypatch.chdir(tmp_path)  # a path with a mistake is not asked for on the Hub
    for wrong, error in (({"policy": "empty/polcy"}, UsageError), ({"critic": "empty/crtic"}, SourceError)):
        with pytest.raises(error, match="there is no such folder"):
            run_rollouts(replace(plan, **wrong), tmp_path / "out", episodes=1)
