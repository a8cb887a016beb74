"""lerobot makes our environments, evaluates a policy in them, and sees what its own LIBERO environment shows."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytestmark = [pytest.mark.sim, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""


@pytest.fixture(scope="module")
def lerobot_env():
    pytest.importorskip("lerobot")
    from jiti.runtime.sim import lerobot_env

    return lerobot_env


def test_tasks_are_named_by_id_or_by_kind(lerobot_env):
    assert lerobot_env.JitiEnv(task="elegant").task_ids == [f"elegant/T{k}" for k in range(8)]
    assert lerobot_env.JitiEnv(task="T2,g4/ketchup,T2").task_ids == ["elegant/T2", "g4/ketchup"]
    assert len(lerobot_env.JitiEnv(task="elegant,rq3,g4").task_ids) == 21


def test_lerobot_makes_them_side_by_side(lerobot_env):
    """In lerobot's vector environments, with its observations, and what its evaluation counts at the end."""
    import torch
    from lerobot.envs.factory import make_env
    from lerobot.envs.utils import preprocess_observation

    config = lerobot_env.JitiEnv(task="T2", pixels=False, episode_length=4)
    envs = make_env(config, n_envs=2)
    env = envs["elegant"][0]
    try:
        assert env.call("_max_episode_steps") == (4, 4)
        assert env.call("task_description") == ("put the bowl on the plate",) * 2
        seen, _ = env.reset(seed=[0, 1])
        observation = preprocess_observation(seen)
        assert observation["observation.state"].shape == (2, 8)
        state = observation["observation.environment_state"]
        assert state.shape == (2, *config.features["environment_state"].shape)
        assert not torch.equal(state[0], state[1])
        for _ in range(4):
            _, reward, _terminated, truncated, info = env.step(np.zeros((2, 7), np.float32))
        assert truncated.all()
        assert (reward == 0).all()
        assert info["final_info"]["is_success"].tolist() == [False, False]
        assert info["final_info"]["is_elegant"].tolist() == [False, False]
    finally:
        env.close()


@pytest.mark.slow
def test_the_plugin_is_found_by_lerobots_command_line():
    code = (
        "import sys\nsys.argv = ['x', '--env.discover_packages_path=jiti.runtime.sim.lerobot_env', '--env.type=jiti',"
        " '--env.task=T2']\n"
        "from dataclasses import dataclass\nfrom lerobot.configs import parser\n"
        "from lerobot.envs.configs import EnvConfig\n"
        "@dataclass\nclass C:\n    env: EnvConfig\n"
        "@parser.wrap()\ndef main(cfg: C):\n"
        "    print(type(cfg.env).__name__, cfg.env.task_ids, sorted(cfg.env.features))\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[-2] == (
        "JitiEnv ['elegant/T2'] ['action', 'agent_pos', 'pixels/image', 'pixels/image2']"
    )


SEEN_BY_BOTH = """
import json, sys
import numpy as np
import mujoco
from jiti.runtime.sim.gl import find_graphics
from jiti.runtime.sim.proprio import proprio
from jiti.runtime.sim.scene import Scene
from jiti.tasks.catalogue import load_catalogue

task = load_catalogue().task("elegant/T2")
scene = Scene(task, assets=sys.argv[1], graphics=find_graphics(), cameras=("front", "wrist"))
from lerobot.envs.libero import LiberoEnv
from lerobot.envs.utils import preprocess_observation
from lerobot.processor.env_processor import LiberoProcessorStep
from libero.libero import benchmark

suite = benchmark.get_benchmark_dict()["libero_goal"]()
number = next(k for k in range(10) if suite.get_task(k).name == task.bddl.partition("/")[2])
theirs = LiberoEnv(suite, number, "libero_goal", obs_type="pixels_agent_pos")
seen, _ = theirs.reset(seed=0)
state = seen["robot_state"]
batch = {
    "pixels": {k: v[None] for k, v in seen["pixels"].items()},
    "robot_state": {
        "eef": {k: state["eef"][k][None] for k in ("pos", "quat")},
        "gripper": {"qpos": state["gripper"]["qpos"][None]},
    },
}
observation = LiberoProcessorStep()._process_observation(preprocess_observation(batch))
scene.reset(0)
raw = theirs._env.env.sim
model, data = raw.model._model, raw.data._data
scene.world.data.qpos[:] = data.qpos
scene.world.model.body_pos[:], scene.world.model.body_quat[:] = model.body_pos, model.body_quat
mujoco.mj_forward(scene.world.model, scene.world.data)
mujoco.mj_forward(model, data)
observation["state"] = observation["observation.state"][0].numpy()
told = {"state": float(np.abs(proprio(scene) - observation["state"]).max())}
for ours, name in (("front", "image"), ("wrist", "image2")):
    picture = observation[f"observation.images.{name}"][0].permute(1, 2, 0).numpy()
    upright = scene.render(ours).astype(float) / 255
    told[ours] = [float(np.abs(p - picture).mean()) for p in (upright[:, ::-1], upright)]
scene.close()
theirs.close()
print(json.dumps(told))
"""


@pytest.mark.slow
@pytest.mark.usefixtures("graphics")
def test_state_and_pictures_are_those_of_lerobots_own_libero_environment(libero_assets, tmp_path):
    """The same simulation state seen by both: the 8 numbers, and pictures mirrored as in LIBERO's datasets."""
    script = tmp_path / "seen.py"
    script.write_text(SEEN_BY_BOTH)
    done = subprocess.run(
        [sys.executable, str(script), str(libero_assets)], capture_output=True, text=True, check=False, timeout=280
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    # Of the hand's place theirs is a substep of 2 ms older.
    assert told["state"] < 1e-3
    for camera in ("front", "wrist"):
        mirrored, upright = told[camera]
        assert mirrored < 0.03
        assert upright > 2 * mirrored
