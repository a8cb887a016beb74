"""Rollouts of a real policy and critic, both tiny: exact, the same in every process, refused where they do not fit."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.errors import UsageError
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.agent import open_agent
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.runtime.rollout.run import run_rollouts
from jiti.runtime.sim.proprio import PROPRIO_NAMES
from jiti.tasks.scene_state import scene_state_names
from tests.runtime.candidates.conftest import checkpoint, inputs, tiny_critic, tiny_flow
from tests.runtime.rollout.conftest import NONE, TASK
from tests.runtime.rollout.test_run import actions, decided

# lerobot warns of its own dependencies.
pytestmark = [pytest.mark.slow, pytest.mark.sim, pytest.mark.filterwarnings("ignore")]

SCENE = len(scene_state_names())
SIZE = len(PROPRIO_NAMES) + SCENE


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    policy = checkpoint(tiny_flow(n_action_steps=4, **inputs(scene=SCENE)), folder / "policy")
    critic = tiny_critic(folder / "critic", size=SIZE)
    plan = RolloutPlan(TASK, str(policy), str(critic), (NONE, Guidance("jiti", tau=0.0)), seed=3, most_steps=30)
    return plan, run_rollouts(plan, folder / "out", episodes=1, workers=1), folder / "out"


def test_as_many_actions_of_a_chunk_are_executed_as_the_policy_says(made):
    _, (none, jiti), _ = made
    assert [c.frame for c in none.choices] == [c.frame for c in jiti.choices] == list(range(0, 30, 4))
    assert jiti.interventions == 7
    assert all(len(c.values) == 8 for c in jiti.choices if c.triggered)
    assert len({c.chosen for c in jiti.choices}) > 1


def test_with_one_candidate_guidance_is_exact(made, tmp_path):
    plan, _, out = made
    alone = (Guidance("jiti", candidates=1, tau=0.0), Guidance("full", candidates=1))
    run_rollouts(replace(plan, guidances=alone), tmp_path, episodes=1, workers=1)
    base = actions(out / "none/elegant-T2_0003.mcap")
    for label in ("jiti", "full"):
        np.testing.assert_array_equal(actions(tmp_path / label / "elegant-T2_0003.mcap"), base)


def test_other_processes_play_the_same_and_json_is_all_that_is_printed(made, tmp_path):
    plan, rollouts, out = made
    line = [sys.executable, "-m", "jiti", "rollout", "--task", "T2", "--policy", plan.policy, "--critic", plan.critic]
    line += ["--guidance", "none", "--guidance", "jiti", "--tau", "0", "--seed", "3", "--max-steps", "30", "--json"]
    done = subprocess.run(
        [*line, "--episodes", "2", "--out", "again", "--workers", "2"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [m["elegant"]["of"] for m in told["methods"]] == [2, 2]
    kept = run_rollouts(plan, tmp_path / "again", episodes=1, workers=1)
    assert decided(kept) == decided(rollouts)
    for label in plan.labels:
        name = f"{label}/elegant-T2_0003.mcap"
        np.testing.assert_array_equal(actions(tmp_path / "again" / name), actions(out / name))


def test_none_beside_a_critic_makes_as_much_of_a_chunk_as_what_it_is_compared_with(made, tmp_path):
    plan, _, _ = made
    seen = {"observation.state": np.zeros(len(PROPRIO_NAMES)), "observation.environment_state": np.zeros(SCENE)}
    long = replace(plan, critic=str(tiny_critic(tmp_path / "long", size=SIZE, chunk=9)))
    makes = []
    for guidances, critic in ((plan.guidances, long.critic), ((NONE,), long.critic), ((NONE,), None)):
        sampler = open_agent(replace(long, guidances=guidances, critic=critic), seen).sampler
        noise = np.zeros((1, *sampler.noise_shape), np.float32)
        makes.append(sampler.observe(seen, TASK.instruction).sample(noise).shape[1])
    assert makes == [9, 9, 4]


def test_a_critic_of_other_sizes_is_refused_before_anything_is_played(made, tmp_path):
    plan, _, _ = made
    other = tiny_critic(tmp_path / "other", size=SIZE - 1)
    with pytest.raises(UsageError, match=f"features of 1 x {SIZE - 1} numbers, and state gives 1 x {SIZE}"):
        run_rollouts(replace(plan, critic=str(other)), tmp_path / "out", episodes=1, workers=1)
    long = tiny_critic(tmp_path / "long", size=SIZE, chunk=12)
    with pytest.raises(UsageError, match="chunks of 12 actions, and the policy gives 10"):
        run_rollouts(replace(plan, critic=str(long)), tmp_path / "out2", episodes=1, workers=1)
    assert not list(tmp_path.glob("out*/*/*"))
    # Nothing was played, so the folder takes the right one.
    (_, jiti) = run_rollouts(plan, tmp_path / "out", episodes=1, workers=1)
    assert jiti.interventions == 7
