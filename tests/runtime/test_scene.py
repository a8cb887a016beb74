"""Every simulated task builds, resets and steps, with our own asset pack and with LIBERO's."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.sim.libero import PRIMITIVE
from jiti.runtime.sim.monitor import Monitor
from jiti.runtime.sim.scene import SETTLE_STEPS, Scene
from jiti.tasks.catalogue import load_catalogue

pytestmark = pytest.mark.sim

CATALOGUE = load_catalogue()
SIMULATED = [task.task_id for task in CATALOGUE if task.bddl]


@pytest.fixture(params=["primitive", pytest.param("libero", marks=pytest.mark.slow)])
def assets(request: pytest.FixtureRequest) -> str:
    """Our pack, and LIBERO's where it lies beside the checkout."""
    return request.param if request.param == "primitive" else str(request.getfixturevalue("libero_assets"))


@pytest.mark.parametrize("task_id", SIMULATED)
def test_a_task_builds_resets_and_steps(task_id: str, assets: str) -> None:
    with Scene(CATALOGUE.task(task_id), assets=assets) as scene:
        scene.reset(4)
        world = scene.world
        assert not scene.succeeded()
        monitor = Monitor(scene)
        before = {name: world.position(name) for name in world.names.objects}
        hand = scene.world_T_eef[:3, 3]
        for _ in range(5):
            scene.step(np.array([0, 0, 0.5, 0, 0, 0, 1]))
            monitor.look()
        assert scene.world_T_eef[2, 3] > hand[2] + 0.01
        assert scene.finger_m[0] < 0.03
        # What the arm does not touch lies still.
        for name, place in before.items():
            if task_id != "elegant/T1" or name != "ketchup_1":  # LIBERO's own states stand it on the arm
                assert np.linalg.norm(world.position(name) - place) < 0.002, name
        assert monitor.outcome().verdicts.keys() == {itc.itc_id for itc in scene.task.itcs}
        assert not monitor.outcome().elegant


@pytest.fixture(scope="module")
def bowl():
    with Scene(CATALOGUE.task("elegant/T2")) as scene:
        yield scene


def test_a_seed_gives_the_same_state_to_the_last_bit(bowl: Scene) -> None:
    def run() -> np.ndarray:
        bowl.reset(11)
        for k in range(8):
            bowl.step(np.array([0.5, -0.3, -0.8, 0, 0, 0.2 * (k % 2), 1.0]))
        return np.concatenate([bowl.world.data.qpos, bowl.world.data.qvel])

    first = run()
    bowl.reset(12)
    bowl.step(np.ones(7))
    np.testing.assert_array_equal(run(), first)


@pytest.mark.parametrize("task_id", [f"elegant/T{k}" for k in (0, 2, 3, 6, 7)])
def test_a_step_is_robosuites_own_to_the_last_bit(task_id: str) -> None:
    """With and without turns, the hand opening and closing, in the air and driven down into whatever is there."""
    with Scene(CATALOGUE.task(task_id)) as scene:
        data = scene.world.data

        def run(step) -> np.ndarray:
            scene.reset(11)
            random = np.random.default_rng(0)
            seen = []
            for k in range(60):
                action = random.uniform(-1, 1, 7)
                if k % 3 == 0:
                    action[3:6] = 0
                if k >= 20:
                    action[2] = -1
                step(action)
                seen.append(np.concatenate([data.ctrl, data.qpos, data.qvel, data.xpos.ravel()]))
            assert len(data.contact)
            return np.array(seen)

        np.testing.assert_array_equal(run(scene.step), run(scene._env.step))


def test_numpys_own_generator_is_left_as_it_was(bowl: Scene) -> None:
    np.random.seed(1)
    expected = np.random.random()
    np.random.seed(1)
    bowl.reset(3, "sampled")
    assert np.random.random() == expected


def test_a_file_start_is_liberos_own_state(bowl: Scene) -> None:
    from jiti.runtime.sim.libero import initial_states

    states = initial_states(bowl.task.bddl or "")
    bowl.reset(53, "file")
    address = bowl.world.model.joint("akita_black_bowl_1_joint0").qposadr[0]
    np.testing.assert_allclose(bowl.world.position("akita_black_bowl_1")[:2], states[3][1 + address :][:2], atol=0.003)


def test_the_arm_holds_still_after_a_reset(bowl: Scene) -> None:
    bowl.reset(0)
    pose = bowl.world_T_eef
    for _ in range(SETTLE_STEPS):
        bowl.step(np.array([0, 0, 0, 0, 0, 0, -1.0]))
    np.testing.assert_allclose(bowl.world_T_eef, pose, atol=0.004)


def test_jitter_moves_every_object_and_lets_none_touch(bowl: Scene) -> None:
    places = []
    for seed in range(0, 250, 50):  # LIBERO's first state each time
        bowl.reset(seed)
        places.append([bowl.world.position(name)[:2] for name in bowl.world.names.objects])
        assert not [pair for pair in bowl.world.contacts() if set(pair) <= set(bowl.world.names.objects)]
    spread = np.std(places, axis=0)
    assert (spread > 0.002).all()
    assert (np.ptp(places, axis=0) < 0.035).all()


def test_liberos_own_success_is_untouched(bowl: Scene) -> None:
    """The same predicates, and the goal as the wheel's BDDL file has it."""
    from libero.libero.envs.predicates import VALIDATE_PREDICATE_FN_DICT
    from libero.libero.envs.predicates.base_predicates import On

    Monitor(bowl)
    assert sorted(VALIDATE_PREDICATE_FN_DICT) == sorted(
        ["true", "false", "in", "on", "up", "printjointstate", "open", "close", "turnon", "turnoff"]
    )
    assert type(VALIDATE_PREDICATE_FN_DICT["on"]) is On
    assert bowl._env.parsed_problem["goal_state"] == [["on", "akita_black_bowl_1", "plate_1"]]
    assert bowl.holds("On", "akita_black_bowl_1", "plate_1") == bowl.succeeded() is False


def test_what_a_scene_does_not_have_is_said(bowl: Scene, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"this scene has no 'cup_1'; it has: akita_black_bowl_1"):
        bowl.world.position("cup_1")
    with pytest.raises(UsageError, match="this scene has no 'cup_1'"):
        bowl.holds("On", "cup_1", "plate_1")
    with pytest.raises(UsageError, match="so100/T0 has no BDDL file"):
        Scene(CATALOGUE.task("so100/T0"))
    with pytest.raises(UsageError, match="is no asset pack"):
        Scene(CATALOGUE.task("elegant/T2"), assets=tmp_path)


def test_a_pack_that_lacks_something_is_answered_with_the_check(tmp_path: Path) -> None:
    pack = tmp_path / "mine"
    shutil.copytree(PRIMITIVE, pack)
    (pack / "stable_scanned_objects/plate/plate.xml").unlink()
    with pytest.raises(UsageError, match=r"does not build elegant/T2: .*plate\.xml.*jiti tasks check --assets"):
        Scene(CATALOGUE.task("elegant/T2"), assets=pack)
    (pack / "stable_scanned_objects/plate/plate.xml").write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(UsageError, match=r"does not build elegant/T2: .*jiti tasks check --assets"):
        Scene(CATALOGUE.task("elegant/T2"), assets=pack)
