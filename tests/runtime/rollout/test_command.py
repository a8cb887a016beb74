"""`jiti rollout` as it is asked: what it takes where it is not told, what it says first, and what it refuses."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from jiti.episodes.mcap_writer import McapWriter
from jiti.errors import UsageError
from jiti.runtime.rollout.command import Done, Request, run_request
from jiti.runtime.rollout.find import newest_critic, newest_policy, newest_task
from jiti.runtime.rollout.report import Report
from jiti.runtime.rollout.tau import CALIBRATION_EPISODES, CALIBRATION_SEED, load_calibrations
from jiti.tasks.catalogue import load_catalogue
from tests.builders.rollout_agents import wandering
from tests.runtime.rollout.conftest import STEPS, write_critic, write_policy

CATALOGUE = load_catalogue()
SHORT = Request(episodes=1, seed=7, most_steps=STEPS, workers=1)


def aged(folder, age_s: float):
    weights = folder / "model.safetensors"
    os.utime(weights, (1e9 - age_s, 1e9 - age_s))
    return folder


def recording(path, task: str, age_s: float):
    with McapWriter(path, instruction="put it there", metadata={"task": task}) as writer:
        writer.write_vector("/action", 0, ["x"], [0.0])
    os.utime(path, (1e9 - age_s, 1e9 - age_s))
    return path


def ask(request, here, **more):
    said: list[str] = []
    done = run_request(request, CATALOGUE, lambda *_: None, said.append, here=here, make_agent=wandering, **more)
    return done, said


@pytest.fixture
def here(tmp_path):
    """A folder in which demonstrations were recorded, and a policy and a critic trained, each twice."""
    aged(write_policy(tmp_path / "old/checkpoints/000100/pretrained_model"), 90)
    aged(write_policy(tmp_path / "new/checkpoints/000100/pretrained_model"), 50)
    aged(write_policy(tmp_path / "new/checkpoints/000200/pretrained_model"), 40)
    (tmp_path / "new/checkpoints/last").symlink_to("000200")
    aged(write_critic(tmp_path / "critic", b"old"), 80)
    aged(write_critic(tmp_path / "critic-2", b"new"), 30)
    aged(write_critic(tmp_path / "critic-2/checkpoints/step-00000100"), 0)
    (tmp_path / "other").mkdir()
    (tmp_path / "other/config.json").write_text(json.dumps({"model_type": "llama"}))
    (tmp_path / "other/model.safetensors").touch()
    recording(tmp_path / "demos/a.mcap", "elegant/T0", 70)
    recording(tmp_path / "demos/b.mcap", "elegant/T2", 60)
    recording(tmp_path / "real/c.mcap", "so100/T0", 10)
    rollouts = tmp_path / "rollouts/elegant-T5"
    recording(rollouts / "none/elegant-T5_0007.mcap", "elegant/T5", 0)
    (rollouts / "plan.json").write_text('{\n  "format": "jiti rollout"}')
    return tmp_path


def test_the_newest_policy_critic_and_recorded_task_are_found(here):
    assert newest_policy(here) == here / "new/checkpoints/000200/pretrained_model"
    assert newest_critic(here) == here / "critic-2"
    task, path = newest_task(here, CATALOGUE)
    assert (task.task_id, path) == ("elegant/T2", here / "demos/b.mcap")
    assert (
        newest_policy(here / "demos") is newest_critic(here / "demos") is newest_task(here / "real", CATALOGUE) is None
    )


@pytest.mark.parametrize("task", ["elegant/T0", "elegant/T2"])
def test_a_critic_that_did_not_learn_from_the_task_is_told(here, tmp_path, task):
    config = here / "critic-2/config.json"
    config.write_text(json.dumps(json.loads(config.read_bytes()) | {"dataset": {"tasks": ["elegant/T2"]}}))
    said: list[str] = []
    asked = replace(SHORT, task=task, guidance=("jiti",), cameras=("side",), out=tmp_path / "out")
    with pytest.raises(UsageError, match="no camera"):
        run_request(asked, CATALOGUE, lambda *_: None, said.append, here=here, make_agent=wandering)
    told = "note: the critic learned from elegant/T2, and not from elegant/T0"
    assert [line for line in said if line.startswith("note")] == [told] * (task == "elegant/T0")


@pytest.mark.slow
@pytest.mark.sim
def test_without_options_it_says_what_it_takes_calibrates_and_compares(here, tmp_path):
    short = replace(SHORT, seed=None, most_steps=15, out=tmp_path / "out")
    (tmp_path / "out/branch").mkdir(parents=True)
    (tmp_path / "out/branch/plan.json").write_text("{}")  # of --branch, which is beside the guidances
    report, said = ask(short, here)
    assert isinstance(report, Report)
    assert said[0].startswith("task elegant/T2, as the newest recording under ")
    assert said[0].endswith(" has it: demos/b.mcap")
    assert said[1].startswith("policy new/checkpoints/000200/pretrained_model, the newest under")
    assert said[2].startswith("critic critic-2, the newest under")
    first, last = CALIBRATION_SEED, CALIBRATION_SEED + CALIBRATION_EPISODES - 1
    assert f"20 unguided episodes with seeds {first} to {last}, none of which is evaluated" in said[3]
    (kept,) = load_calibrations(here / "critic-2/tau.json")
    assert said[4].startswith(f"tau is {kept.tau:.4g}, kept in ")
    assert [m.label for m in report.methods] == ["none", "jiti"]
    assert {r.seed for r in report.rollouts} == {100_000}
    told = json.loads(report.to_json())
    assert told["tau"] == kept.tau
    assert told["calibration"]["rate"] == 0.339
    assert told["pairings"][0]["pairs"] == 1

    halved, said = ask(replace(short, guidance=("jiti",), tau_scale=0.5, out=tmp_path / "half"), here)
    assert "from" in said[3]
    assert json.loads(halved.to_json())["tau"] == kept.tau / 2


@pytest.mark.sim
def test_tau_is_calibrated_alone_and_kept_with_the_critic(here, tmp_path):
    asked = replace(SHORT, task="T2", calibrate_tau=0.25, episodes=2, seed=None, out=tmp_path / "out")
    done, _ = ask(asked, here)
    assert isinstance(done, Done)
    (kept,) = load_calibrations(here / "critic-2/tau.json")
    assert (kept.rate, kept.seeds, kept.decisions) == (0.25, (CALIBRATION_SEED, CALIBRATION_SEED + 2), 10)
    assert f"{kept.measured:.1%} of 10 decisions" in done.text
    assert "25.0% was asked for" in done.text
    assert json.loads(done.to_json())["tau"] == kept.tau


def test_what_is_missing_is_said_with_what_makes_it(here, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(UsageError, match=r"no recording of a task.*jiti record --task elegant/T2"):
        ask(SHORT, empty)
    with pytest.raises(UsageError, match=r"no policy of lerobot.*--policy.*lerobot-train"):
        ask(replace(SHORT, task="T2"), empty)
    with pytest.raises(UsageError, match=r"no critic.*jiti train-critic.*--guidance none"):
        ask(replace(SHORT, task="T2"), here / "new")


@pytest.mark.parametrize("content", ["{", "[]", '{"input_features": [1]}', '{"input_features": 3}', b"\xff"])
def test_a_policy_whose_configuration_is_damaged_is_named(here, content):
    config = here / "new/checkpoints/000200/pretrained_model/config.json"
    config.write_bytes(content if isinstance(content, bytes) else content.encode())
    asked = replace(SHORT, task="T2", policy=str(config.parent), guidance=("none",))
    with pytest.raises(UsageError, match=rf"{config} is damaged: .*pass another --policy"):
        ask(asked, here)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"calibrate_tau": 0.3, "guidance": ("jiti",)}, "leave --guidance out"),
        ({"calibrate_tau": 0.3, "tau": 1.0}, "leave --tau out"),
        ({"calibrate_tau": 0.3, "tau_scale": 0.5, "pick": "worst"}, "leave --pick and --tau-scale out"),
        ({"calibrate_tau": 0.3, "candidates": 4}, "leave --candidates out"),
        ({"branch": ("best",), "guidance": ("jiti",)}, "leave --guidance out"),
        ({"branch": ("best",), "live": True}, "--branch and --live are two things"),
        ({"tau_scale": 0.0}, "--tau-scale 0 must be above 0"),
        ({"guidance": ("none", "full"), "tau_scale": 2.0}, "no --guidance jiti is asked for: leave --tau"),
        ({"guidance": ("none:worst", "jiti")}, "nothing to pick from. Pass --guidance none"),
        ({"live": True, "workers": 2}, "leave --workers out"),
        ({"guidance": ("jitter",)}, "--guidance jitter: there are none, jiti, full"),
        ({"branch": ("best", "worst"), "pick": "random"}, "leave --pick out, or add random to --branch"),
        ({"branch": ("best", "worst", "best")}, "--branch names best twice"),
        ({"calibrate_tau": 0.0, "live": True}, "--calibrate-tau and --live are two things"),
        ({"calibrate_tau": 0.0}, r"rate of 0\.0; it must be between 0 and 1"),
        ({"branch": ("good",)}, "--pick good: there are best"),
        ({"cameras": ("side",)}, "no camera 'side'"),
        ({"calibrate_tau": 2.0}, "between 0 and 1"),
    ],
)
def test_options_that_do_not_fit_name_themselves(here, tmp_path, changed, said):
    with pytest.raises(UsageError, match=said):
        ask(replace(SHORT, **{"out": tmp_path / "out", "workers": None, **changed}), here)


@pytest.mark.sim
@pytest.mark.parametrize(
    "way", [{}, {"live": True}, {"branch": ("best", "worst")}, {"calibrate_tau": 0.3, "tau": None}]
)
def test_a_file_in_the_place_of_the_folder_is_refused(here, tmp_path, way):
    (tmp_path / "out").write_text("a file")
    asked = replace(SHORT, task="T2", tau=0.1, out=tmp_path / "out", workers=None)
    with pytest.raises(UsageError, match=rf"--out {tmp_path / 'out'} is a file; it must be a folder"):
        ask(replace(asked, **way), here)


@pytest.mark.sim
def test_a_folder_of_another_task_is_refused_before_tau_is_calibrated(here, tmp_path):
    asked = replace(SHORT, task="T2", guidance=("none",), out=tmp_path / "out")
    ask(asked, here)
    with pytest.raises(
        UsageError, match=r"holds rollouts with task 'elegant/T2' and not 'elegant/T4'\. Choose another"
    ):
        ask(replace(asked, task="T4", guidance=("jiti",)), here)
    assert not (tmp_path / "out/calibration").exists()


@pytest.mark.sim
def test_one_episode_is_continued_in_several_ways_from_its_first_trigger(here, tmp_path):
    from jiti.runtime.rollout.branch import Branched, branch
    from jiti.runtime.rollout.plan import RolloutPlan
    from tests.runtime.rollout.conftest import TASK, Guidance

    picks = ("best", "median", "worst")
    ways = tuple(Guidance("jiti", pick, 8, 5, 0.5) for pick in picks)
    policy, critic = (str(found) for found in (newest_policy(here), newest_critic(here)))
    plan = RolloutPlan(TASK, policy, critic, ways, 7, most_steps=STEPS)
    made = branch(plan, tmp_path / "branch", episodes=3, make_agent=wandering)
    assert isinstance(made, Branched)
    assert [r.pick for r in made.rollouts] == list(picks)
    trigger = next(k for k, c in enumerate(made.rollouts[0].choices) if c.triggered)
    assert made.frame == made.rollouts[0].choices[trigger].frame > 0
    before = [[(c.q_t, c.chosen) for c in r.choices[:trigger]] for r in made.rollouts]
    assert before[0] == before[1] == before[2]
    at = [r.choices[trigger] for r in made.rollouts]
    assert at[0].values == at[1].values == at[2].values
    taken = [c.values[c.chosen] for c in at]
    assert taken[0] == max(at[0].values)
    assert taken[2] == min(at[0].values)
    assert taken[0] > taken[1] > taken[2]
    entities = entities_of(made.recording)
    for pick in picks:
        expected = {f"/scene/{pick}/hand", f"/scene/{pick}/path", f"/scene/{pick}/things", f"/values/{pick}"}
        assert expected <= entities
    assert json.loads(json.dumps(made.to_json()))["frame"] == made.frame
    assert "side by side, without pictures" in str(made)
    never = replace(plan, guidances=tuple(replace(way, tau=1e9) for way in ways))
    with pytest.raises(UsageError, match=r"nothing triggered in 1 episodes.*--tau-scale"):
        branch(never, tmp_path / "never", episodes=1, make_agent=wandering)


@pytest.mark.sim
def test_branches_agree_where_the_critic_gives_no_number(plan, tmp_path):
    from jiti.runtime.rollout.branch import branch
    from tests.builders import rollout_agents
    from tests.runtime.rollout.conftest import Guidance

    ways = tuple(Guidance("jiti", pick, tau=0.5) for pick in ("best", "worst"))
    made = branch(
        replace(plan, guidances=ways), tmp_path / "branch", episodes=1, make_agent=rollout_agents.first_without_number
    )
    first = made.rollouts[0].choices
    assert first[0].problem
    assert made.frame == next(c.frame for c in first if c.triggered) > first[0].frame


@pytest.mark.sim
def test_what_is_shown_live_is_kept_and_played_as_ever(plan, tmp_path):
    from jiti.runtime.rollout.live import watch_live
    from jiti.runtime.rollout.run import run_rollouts

    said: list[str] = []
    shown = watch_live(plan, tmp_path / "live", episodes=1, say=said.append, make_agent=wandering, viewer=False)
    played = run_rollouts(plan, tmp_path / "played", episodes=1, workers=1, make_agent=wandering)
    decided = [[[str(c.q_t) + str(c.values) for c in r.choices] for r in many] for many in (shown, played)]
    assert decided[0] == decided[1]
    assert len(said) == 3
    entities = entities_of(tmp_path / "live/full/elegant-T2_0007.rrd")
    expected = {"/values/q", "/values/triggered", "/jumps/delta_q", "/scene/candidates", "/scene/hand", "/scene/path"}
    assert expected | {"/scene/things", "/said", "/about"} <= entities
    quiet = entities_of(tmp_path / "live/none/elegant-T2_0007.rrd")
    assert "/scene/candidates" in quiet


def entities_of(path) -> set[str]:
    import rerun as rr

    recorded = rr.experimental.RrdReader(path).store()
    return {str(column.entity_path) for column in recorded.schema().component_columns()}


def test_paths_of_chunks_begin_at_the_hand_and_add_up():
    import numpy as np

    from jiti.runtime.rollout.chunk_path import FOLLOWED, chunk_path

    chunks = np.zeros((2, 10, 7))
    chunks[1, :, 0] = 1
    paths = chunk_path(np.array([0.1, 0.2, 0.3]), chunks)
    assert paths.shape == (2, 11, 3)
    np.testing.assert_allclose(paths[0], np.tile([0.1, 0.2, 0.3], (11, 1)))
    np.testing.assert_allclose(paths[1, -1], [0.1 + 10 * 0.05 * FOLLOWED, 0.2, 0.3])
    chunks[1, :, 0] = 3  # of which the environment executes 1
    np.testing.assert_allclose(chunk_path(np.array([0.1, 0.2, 0.3]), chunks), paths)


def test_the_command_line_refuses_in_one_message(tmp_path):
    def run(*args: str):
        line = [sys.executable, "-m", "jiti", "rollout", *args]
        return subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)

    done = run()
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("jiti: no recording of a task of simulation was found under the current folder")
    done = run("--task", "T9")
    assert "no task of simulation is 'T9'" in done.stderr
