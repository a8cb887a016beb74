"""A hand moves an arm without torque, and closes the drawer with more care or less."""

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.robot.virtual import demonstrator
from jiti.runtime.robot.virtual import registers as r
from jiti.runtime.robot.virtual.demonstrator import REST, demonstrate, home, now
from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.hand import STRENGTH_NM, Path, smooth, wander
from jiti.runtime.robot.virtual.reach import Reach
from jiti.runtime.robot.virtual.scenes import EMPTY, load
from jiti.runtime.robot.virtual.world import World

mujoco = pytest.importorskip("mujoco", reason="pip install 'jiti[robot]'")
T5 = "so100/T5"


def led(world: World, path: Path) -> list[float]:
    """Openings of the drawer while a hand moves the arm to the path's end."""
    world.lead(path)
    openings = []
    while not world.led():
        world.step()
        openings.extend(world.state().drawers.values())
    return openings


def demonstrated(seed: int, quality: float):
    world = World(T5, seed=seed)
    shown = demonstrate(T5, world.state(), seed, quality)
    return world, shown, np.array(led(world, shown.path))


def test_a_smooth_path_begins_and_ends_at_rest_and_paths_follow_each_other():
    a, b, c = np.zeros(6), np.ones(6), np.full(6, 3.0)
    path = smooth([a, b], 1.0).then(smooth([b, c], 2.0))
    assert path.lasts_s == pytest.approx(3.0)
    for time_s, place in ((0.0, a), (1.0, b), (3.0, c), (9.0, c)):
        np.testing.assert_allclose(path.at(time_s), place, atol=1e-9)
    speeds = np.diff(path.angles_rad[:, 0]) / np.diff(path.times_s)
    assert speeds.min() >= 0
    assert speeds[[0, -1]].max() < 0.05 < speeds.max()


@pytest.mark.parametrize("seed", range(20))
def test_a_path_astray_begins_and_ends_as_it_was(seed):
    path, most_rad = smooth([np.zeros(6), np.full(6, 2.0)], 3.0), np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.0])
    strayed = wander(path, most_rad, np.random.default_rng(seed))
    off = strayed.angles_rad - path.angles_rad
    np.testing.assert_array_equal(strayed.times_s, path.times_s)
    np.testing.assert_allclose(off[[0, -1]], 0, atol=1e-9)
    assert (np.abs(off[:, :5]).max(axis=0) > 0.01).all(), "every joint that may stray does"
    assert (np.abs(off) < most_rad + 1e-9).all()
    steps = np.abs(np.diff(off, axis=0))
    assert steps.max() < 0.02, "radians in 20 ms: nothing jumps"
    assert steps[[0, -1]].max() < 0.001, "it begins and ends as slowly"


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_strays_on_its_way_alone_and_touches_nothing_there(seed, monkeypatch):
    _, shown, openings = demonstrated(seed, quality=1.0)
    monkeypatch.setattr(demonstrator, "WANDER_RAD", np.zeros(6))
    straight = demonstrate(T5, World(T5, seed=seed).state(), seed, 1.0).path
    assert shown.path.lasts_s == straight.lasts_s
    astray = np.abs(shown.path.angles_rad - straight.angles_rad).max(axis=1) > 1e-6
    on_the_way = np.flatnonzero(astray)[-1]
    assert 3.0 < straight.times_s[on_the_way] < 3.6, "seconds until the fingers are before the handle"
    before = openings[: round(straight.times_s[on_the_way] / 0.005) - 20]
    np.testing.assert_allclose(before, openings[0], atol=1e-4, err_msg="metres that the drawer stands open")


@pytest.mark.parametrize(
    ("tip", "pitch"), [((0.2, -0.1, 0.11), 0.6), ((0.25, -0.2, 0.11), 0.2), ((0.24, 0.1, 0.05), 0.8)]
)
def test_the_tips_of_the_jaws_come_where_they_are_to_be(tip, pitch):
    model = load(EMPTY)
    data = mujoco.MjData(model)
    data.qpos[:] = Reach().angles(np.array(tip), pitch)
    mujoco.mj_kinematics(model, data)
    jaw, (length, _, height) = data.geom("fixed_jaw"), model.geom("fixed_jaw").size
    turned = jaw.xmat.reshape(3, 3)
    np.testing.assert_allclose(jaw.xpos + turned @ [length, 0, height], tip, atol=1e-6)
    assert turned[2, 0] == pytest.approx(-np.sin(pitch)), "it leans down"


def test_an_arm_alone_is_led_and_its_servos_have_no_torque():
    world = World(EMPTY)
    place = np.array([0.4, -0.5, 0.9, -0.3, 0.8, 0.5])
    led(world, smooth([now(world.state()), place], 2.0))
    world.step(100)
    np.testing.assert_allclose(now(world.state()), place, atol=0.03)
    assert all(servo.memory[r.TORQUE_ENABLE] == 0 for servo in world.servos.values())


def test_a_hand_is_no_stronger_than_a_person():
    world = World(EMPTY, faults=Faults(jam=frozenset({1})))
    led(world, smooth([now(world.state()), now(world.state()) + [1, 0, 0, 0, 0, 0]], 0.5))
    assert abs(now(world.state())[0]) < 0.01
    assert world.data.qfrc_applied.max() == STRENGTH_NM


@pytest.mark.parametrize("seed", range(4))
def test_a_careful_hand_closes_the_drawer_in_one_push(seed):
    world, shown, openings = demonstrated(seed, quality=1.0)
    assert shown.manner == "careful"
    assert openings[0] > 0.049
    assert openings[-1] < 0.001
    speed = -np.diff(openings) / 0.005
    assert speed.max() < 0.12, "m/s: nothing is slammed"
    moves = np.flatnonzero(speed > 0.005)
    assert np.diff(moves).max() < 20, "without a stop of a tenth of a second"
    led(world, home(world.state()))
    np.testing.assert_allclose(now(world.state()), REST, atol=0.03)
    assert world.state().drawers["top_drawer"] < 0.001


def test_a_careless_hand_does_what_the_constraint_names():
    seen = {}
    for seed in range(12):
        _, shown, openings = demonstrated(seed, quality=0.0)
        seen.setdefault(shown.manner, []).append(openings)
    assert set(seen) == {"stops on the way", "slams it", "leaves a gap"}
    assert all(openings[-1] > 0.005 for openings in seen["leaves a gap"])
    assert all(-np.diff(openings).min() / 0.005 > 0.2 for openings in seen["slams it"])
    for openings in seen["stops on the way"]:
        moves = np.flatnonzero(-np.diff(openings) / 0.005 > 0.005)
        assert np.diff(moves).max() > 50, "a quarter of a second"
        assert openings[-1] < 0.001


def test_one_seed_is_one_demonstration_and_what_no_one_shows_is_told():
    state = World(T5, seed=3).state()
    one, same, other = (demonstrate(T5, state, seed, 0.5) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.path.angles_rad, same.path.angles_rad)
    assert one.path.lasts_s != other.path.lasts_s
    with pytest.raises(UsageError, match=r"no one demonstrates so100/T4 .* knows: so100/T5"):
        demonstrate("so100/T4", state, 0, 0.5)
