"""Where things are as one vector: of one size for every task, by roles, from the hand and the moved thing."""

import numpy as np
import pytest

from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.scene_state import SLOTS, roles, scene_state, scene_state_names

NAMES = scene_state_names()
TURNED = np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])
"""A quarter turn to the left."""


def pose(x: float, y: float, z: float, quaternion=(0.0, 0.0, 0.0, 1.0)) -> np.ndarray:
    return np.array([[x, y, z, *quaternion]])


def named(vector: np.ndarray, start: str) -> list[float]:
    return [round(float(v), 6) + 0.0 for name, v in zip(NAMES, vector[0], strict=True) if name.startswith(start)]


def test_places_are_from_the_hand_and_from_what_it_moves():
    poses = {"bowl": pose(1, 2, 3, TURNED), "plate": pose(1, 2, 1)}
    vector = scene_state(np.array([[0.5, 2, 3]]), poses, ["bowl", "plate"], np.array([True]))
    assert vector.dtype == np.float32
    assert named(vector, "thing_0.touched") == [1]
    assert named(vector, "thing_0.from_hand") == [0.5, 0, 0]
    assert named(vector, "thing_1.from_hand") == [0.5, 0, -2]
    assert named(vector, "thing_1.from_thing_0") == [0, 0, -2]
    assert named(vector, "thing_0.x_axis") == [0, 1, 0]
    assert named(vector, "thing_0.z_axis") == [0, 0, 1]
    assert not any(named(vector, "thing_2"))


def test_moving_parts_are_told_as_many_as_have_a_place():
    poses = {"cabinet": pose(0, 0, 0), "stove": pose(1, 0, 0), "plate": pose(2, 0, 0)}
    joints = {"cabinet": np.array([[0.1, 0.2, 0.3, 0.4]]), "stove": np.array([[0.5]]), "elsewhere": np.array([[9.0]])}
    vector = scene_state(np.zeros((1, 3)), poses, [*poses], np.zeros(1), joints)
    assert [named(vector, f"thing_{k}.joint") for k in range(4)] == [[0.1, 0.2, 0.3], [0.5, 0, 0], [0] * 3, [0] * 3]


@pytest.mark.parametrize("count", [1, 3, SLOTS, SLOTS + 4])
def test_any_number_of_things_gives_the_same_numbers(count):
    poses = {f"thing_{k}": np.repeat(pose(k, 0, 0), 5, axis=0) for k in range(count)}
    assert scene_state(np.zeros((5, 3)), poses, list(poses), np.zeros(5)).shape == (5, len(NAMES))


def test_moving_the_whole_scene_changes_nothing():
    rng = np.random.default_rng(3)
    hand, shift = rng.normal(size=(4, 3)), np.array([0.3, -2, 1])
    poses = {name: rng.normal(size=(4, 7)) for name in "abc"}
    moved = {name: p + np.append(shift, np.zeros(4)) for name, p in poses.items()}
    args = list("abc"), np.zeros(4)
    np.testing.assert_allclose(scene_state(hand + shift, moved, *args), scene_state(hand, poses, *args), atol=1e-6)


def test_a_frame_is_the_same_to_the_last_bit_alone_and_among_others():
    """The simulator makes one at a time, a recording all at once."""
    rng = np.random.default_rng(4)
    hand, poses = rng.normal(size=(30, 3)), {name: rng.normal(size=(30, 7)) for name in "abcd"}
    together = scene_state(hand, poses, "abcd", np.zeros(30))
    for k in range(30):
        one = {name: pose[k : k + 1] for name, pose in poses.items()}
        np.testing.assert_array_equal(scene_state(hand[k : k + 1], one, "abcd", np.zeros(1))[0], together[k])


def test_what_is_moved_comes_first_then_where_to_then_what_an_itc_speaks_of():
    task = load_catalogue().task("elegant/T6")
    things = ["wine_rack_1", "wine_bottle_1", "akita_black_bowl_1", "plate_1", "cream_cheese_1", "stove_front"]
    order = roles(task, things, moved=["plate_1"], regions=["stove_front"])
    assert order[:2] == ["plate_1", "stove_front"]
    assert set(order[2:5]) == {"akita_black_bowl_1", "cream_cheese_1", "wine_bottle_1"}
    assert order[5:] == ["wine_rack_1"]


def test_things_that_are_not_there_have_no_place():
    assert roles(load_catalogue().task("elegant/T2"), ["plate_1"], moved=["akita_black_bowl_1"]) == ["plate_1"]
