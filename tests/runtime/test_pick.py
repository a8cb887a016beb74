"""The scripted pick lifts the cube however carelessly it is done, and its faults show in what is measured."""

import numpy as np
import pytest

from jiti.runtime.sim.lift import LiftScene, Observation
from jiti.runtime.sim.pick import Manner, ScriptedPick, draw_manner, grasp_rotation, rotation_vector

CARELESS = Manner(aside_m=0.012, turned_rad=0.4, low_m=0.03, hurried=True)


def rotated(yaw: float) -> np.ndarray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def run(graphics, manner: Manner, seed: int) -> tuple[list[Observation], bool]:
    random = np.random.default_rng(seed)
    script, seen = ScriptedPick(manner, random), []
    with LiftScene(graphics, seed=seed, cameras=()) as scene:
        while True:
            seen.append(scene.observe())
            action = script.act(seen[-1])
            if action is None:
                return seen, scene.is_lifted()
            assert (np.abs(action) <= 1).all()
            scene.step(action)


@pytest.mark.sim
@pytest.mark.parametrize(
    "manner",
    [Manner(), Manner(aside_m=-0.012), Manner(turned_rad=-0.4), Manner(low_m=0.03), Manner(hurried=True), CARELESS],
    ids=["careful", "aside", "turned", "low", "hurried", "all at once"],
)
def test_the_cube_is_lifted_and_each_fault_shows(graphics, manner):
    seen, lifted = run(graphics, manner, seed=4)
    assert lifted
    assert seen[-1].world_T_cube[2, 3] - seen[0].world_T_cube[2, 3] > 0.1
    assert 50 <= len(seen) <= 100
    # The fingers are half closed at first, open on the way, and hold the cube, 40 to 44 mm wide, at the end.
    assert max(s.opening_m for s in seen) > 0.075
    assert 0.035 < seen[-1].opening_m < 0.06
    assert seen[-1].touches_cube == (True, True)
    assert any(s.touches_table for s in seen) == (manner.low_m > 0)

    touched = next(s for s in seen if any(s.touches_cube))
    turned = rotation_vector(
        touched.world_T_hand, grasp_rotation(touched.world_T_cube, touched.world_T_hand[:3, :3], 0)
    )
    assert (abs(turned[2]) > np.radians(5)) == (manner.turned_rad != 0)
    # A careful hand waits at the bottom until both fingers touch; a hurried one is on its way up by then.
    heights = [s.world_T_hand[2, 3] for s in seen]
    held = next(k for k, s in enumerate(seen) if all(s.touches_cube))
    assert (heights[held] - min(heights[:held]) > 0.005) == manner.hurried


@pytest.mark.sim
def test_a_seed_decides_the_scene_and_leaves_numpys_generator_alone(graphics):
    np.random.seed(12345)
    expected = np.random.random()
    np.random.seed(12345)
    first = []
    for seed in (1, 1, 2):
        with LiftScene(graphics, seed=seed, cameras=()) as scene:
            first.append(scene.observe())
    assert np.random.random() == expected
    np.testing.assert_array_equal(first[0].world_T_cube, first[1].world_T_cube)
    np.testing.assert_array_equal(first[0].joint_rad, first[1].joint_rad)
    assert not np.allclose(first[0].world_T_cube, first[2].world_T_cube)


def test_manners_vary_and_stay_within_what_was_tried():
    drawn = [draw_manner(np.random.default_rng(seed)) for seed in range(300)]
    careful = sum(m == Manner() for m in drawn)
    assert 0.1 * len(drawn) < careful < 0.35 * len(drawn)
    for m in drawn:
        assert abs(m.aside_m) <= 0.012
        assert abs(m.turned_rad) <= 0.4
        assert m.low_m in (0.0, 0.03)


@pytest.mark.parametrize("yaw", np.linspace(-3, 3, 9))
def test_the_hand_points_down_along_the_nearest_face(yaw):
    hand = grasp_rotation(rotated(0.3), rotated(0.3 + yaw), 0.0)
    np.testing.assert_allclose(hand @ hand.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(hand) == pytest.approx(1)
    np.testing.assert_allclose(hand[:, 2], [0, 0, -1])
    turn = np.arctan2(hand[1, 0], hand[0, 0]) - 0.3
    assert abs((turn + np.pi / 4) % (np.pi / 2) - np.pi / 4) < 1e-9  # a multiple of a quarter turn from the cube
    away = (turn - yaw + np.pi) % (2 * np.pi) - np.pi
    assert abs(away) <= np.pi / 4 + 1e-9


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.1, 1.5, 3.0])
def test_the_rotation_vector_is_axis_times_angle(angle):
    pose = np.eye(4)
    np.testing.assert_allclose(rotation_vector(pose, rotated(angle)), [0, 0, angle], atol=1e-7)
