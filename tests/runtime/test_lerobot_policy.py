"""lerobot's own evaluation plays JITI in a simulated task, several environments side by side."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from tests.runtime.candidates.conftest import checkpoint, inputs, tiny_critic, tiny_flow

pytestmark = [pytest.mark.sim, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""


@pytest.fixture
def jiti(tmp_path):
    """A folder of JITI for the simulated tasks."""
    from jiti.policies import save_jiti
    from jiti.tasks.scene_state import scene_state_names

    scene = len(scene_state_names())
    base = checkpoint(tiny_flow(n_action_steps=4, **inputs(scene=scene)), tmp_path / "base")
    critic = tiny_critic(tmp_path / "critic", size=8 + scene)
    return save_jiti(tmp_path / "jiti", base, critic, tau=0.0, seed=5)


def test_lerobots_rollout_plays_it_side_by_side(jiti):
    from lerobot.envs.factory import make_env, make_env_pre_post_processors
    from lerobot.policies.factory import make_policy, make_pre_post_processors
    from lerobot.scripts.lerobot_eval import rollout

    from jiti.policies.configuration_jiti import JitiConfig
    from jiti.runtime.sim.lerobot_env import JitiEnv

    env_config = JitiEnv(task="T2", pixels=False, episode_length=10)
    config = JitiConfig.from_pretrained(jiti)
    config.pretrained_path = jiti
    policy = make_policy(config, env_cfg=env_config)
    steps = {"device_processor": {"device": "cpu"}, "rename_observations_processor": {"rename_map": {}}}
    pipelines = make_pre_post_processors(config, str(jiti), preprocessor_overrides=steps)
    env = make_env(env_config, n_envs=2)["elegant"][0]
    try:
        found = [
            rollout(env, policy, *make_env_pre_post_processors(env_config, config), *pipelines, seeds=[0, 1])
            for _ in range(2)
        ]
    finally:
        env.close()
    assert found[0]["action"].shape == (2, 10, 7)
    assert not np.allclose(found[0]["action"][0], found[0]["action"][1])
    # The second rollout's noise is of the next two episodes.
    assert not np.allclose(found[0]["action"], found[1]["action"])
    for episode in policy.episodes:
        assert [len(d.values) for d in episode.decisions] == [0, 8, 8]


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("graphics")
def test_lerobot_eval_opens_it_from_its_folder(jiti, tmp_path):
    line = (
        f"--policy.path={jiti}",
        # Not --policy.discover_packages_path, which lerobot 0.6.1 hands on to the config of a policy with a path.
        "--discover_packages_path=jiti.policies",
        "--policy.method=full",
        "--env.discover_packages_path=jiti.runtime.sim.lerobot_env",
        "--env.type=jiti",
        "--env.task=T2",
        "--env.pixels=false",
        "--env.episode_length=6",
        "--eval.n_episodes=2",
        "--eval.batch_size=2",
        f"--output_dir={tmp_path / 'out'}",
    )
    code = "from lerobot.scripts.lerobot_eval import main; main()"
    done = subprocess.run([sys.executable, "-c", code, *line], capture_output=True, text=True, check=False, timeout=540)
    assert done.returncode == 0, done.stderr[-3000:]
    told = json.loads((tmp_path / "out/eval_info.json").read_text())
    assert "pc_success" in json.dumps(told)
