"""The Gymnasium environments: their spaces, their seeds, when they end, and what lerobot sees of them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from jiti.errors import CatalogueError, UsageError
from jiti.runtime.sim.demonstrators import demonstrator_for
from jiti.runtime.sim.gl import Graphics
from jiti.runtime.sim.proprio import axis_angle

pytestmark = pytest.mark.sim

ACTIONS = np.random.default_rng(3).uniform(-1, 1, (6, 7))


@pytest.fixture(scope="module")
def bowl():
    env = gym.make("jiti.runtime.sim.env:elegant/T2", disable_env_checker=True).unwrapped
    yield env
    env.close()


@pytest.mark.filterwarnings("ignore:.*Box observation space (minimum|maximum) value is:UserWarning")
def test_gymnasium_finds_nothing_wrong(bowl):
    check_env(bowl, skip_render_check=True)


def test_every_simulated_task_is_registered_under_its_id():
    import jiti.runtime.sim.env  # noqa: F401 - registers

    for task_id in ("elegant/T0", "elegant/T7", "rq3/unseen-D", "g4/close-microwave"):
        assert gym.spec(task_id).kwargs == {"task": task_id}


def test_a_seed_decides_the_episode_whatever_came_before(bowl):
    def run(seed):
        seen, info = bowl.reset(seed=seed)
        assert info["seed"] == seed
        return [seen, *(bowl.step(action)[0] for action in ACTIONS)]

    first, other, again = run(5), run(6), run(5)
    for key in ("agent_pos", "environment_state"):
        np.testing.assert_array_equal([s[key] for s in first], [s[key] for s in again])
    assert not np.allclose(first[0]["environment_state"], other[0]["environment_state"])


def test_without_a_seed_each_environment_draws_episodes_of_its_own(bowl):
    drawn = []
    for seed in (5, 6, 5):
        bowl.reset(seed=seed)
        drawn.append([bowl.reset()[1]["seed"] for _ in range(3)])
    assert drawn[0] == drawn[2]
    assert len({*drawn[0], *drawn[1]}) == 6


def test_starts_are_liberos_own_files_moved_a_little_or_drawn_anew(bowl):
    starts = {start: bowl.reset(seed=2, options={"start": start})[0] for start in ("file", "jitter", "sampled")}
    names = bowl.environment_state_names
    x, y = names.index("thing_0.from_hand.x_m"), names.index("thing_0.from_hand.y_m")
    place = {start: seen["environment_state"][[x, y]] for start, seen in starts.items()}
    assert 1e-4 < np.abs(place["jitter"] - place["file"]).max() < 0.02
    assert np.linalg.norm(place["sampled"] - place["file"]) < 0.1
    assert not np.allclose(place["sampled"], place["file"], atol=1e-4)


def test_an_elegant_demonstration_is_rewarded_once_and_ends_the_episode(bowl):
    bowl.reset(seed=0)
    actor = demonstrator_for(bowl.scene, 0, 1.0)
    rewards, infos, terminated = [], [], False
    while (action := actor.act()) is not None and not terminated:
        _, reward, terminated, truncated, info = bowl.step(action)
        rewards.append(reward)
        infos.append(info)
        assert not truncated
    assert terminated
    assert rewards == [0.0] * (len(rewards) - 1) + [1.0]
    assert infos[-1]["is_success"]
    assert infos[-1]["is_elegant"]
    (verdict,) = infos[-1]["itcs"].values()
    assert verdict["satisfied"]
    assert not infos[0]["is_success"]


def test_an_episode_in_which_nothing_happens_is_cut_off_and_not_rewarded():
    from jiti.runtime.sim.env import ElegantEnv

    env = ElegantEnv("T2", max_episode_steps=3)
    env.reset(seed=0)
    results = [env.step(np.zeros(7)) for _ in range(3)]
    assert [r[3] for r in results] == [False, False, True]
    assert (results[-1][1], results[-1][4]["is_elegant"]) == (0.0, False)
    env.close()


def test_what_is_wrong_is_said(bowl):
    from jiti.runtime.sim.env import ElegantEnv

    with pytest.raises(UsageError, match="an action has 7 numbers"):
        bowl.step(np.zeros(6))
    with pytest.raises(UsageError, match="'jiter' is no start; there are: jitter, file, sampled"):
        bowl.reset(seed=0, options={"start": "jiter"})
    with pytest.raises(CatalogueError, match=r"no task of simulation is 'T8'; did you mean"):
        ElegantEnv("T8")
    with pytest.raises(UsageError, match="with cameras front: no library"):
        ElegantEnv("T2", cameras=("front",), graphics=Graphics(None, "no library"))


def test_pictures_are_upright_and_differ_between_cameras(graphics):
    from jiti.runtime.sim.env import ElegantEnv

    env = ElegantEnv("T2", cameras=("front", "wrist"), graphics=graphics, picture_size=64)
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    front, wrist = seen["pixels"]["front"].astype(int), seen["pixels"]["wrist"].astype(int)
    assert front.std() > 10
    assert wrist.std() > 10
    assert np.abs(front - wrist).mean() > 10
    np.testing.assert_array_equal(env.render(), seen["pixels"]["front"])
    env.close()


@pytest.mark.slow
def test_an_axis_times_its_angle_is_lerobots():
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    quaternions = np.concatenate([quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), [[0, 0, 0, 1]]])
    torch = pytest.importorskip("torch")
    from lerobot.processor.env_processor import LiberoProcessorStep

    expected = LiberoProcessorStep()._quat2axisangle(torch.from_numpy(quaternions))
    np.testing.assert_allclose([axis_angle(q) for q in quaternions], expected.numpy(), atol=1e-6)
