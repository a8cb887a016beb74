"""Rotations in their several forms, against what they must satisfy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.tasks.rotation import (
    about,
    angle_between,
    angle_to_box,
    hand_down,
    matrices,
    quaternion_xyzw,
    rotation_vector,
    turned_rad,
)

AXIS = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
TURN = st.builds(about, AXIS, st.floats(-np.pi, np.pi))
TURNS = st.lists(TURN, min_size=1, max_size=6).map(np.array)


@given(AXIS, st.floats(0.0, np.pi - 1e-3), AXIS, st.floats(-3, 3))
def test_a_rotation_vector_leads_from_one_to_the_other(axis, angle, other, turn):
    now = about(other, turn)
    vector = rotation_vector(now, about(axis, angle) @ now)
    np.testing.assert_allclose(vector, angle * axis / np.linalg.norm(axis), atol=1e-6)


@given(AXIS)
def test_half_a_turn_keeps_its_angle(axis):
    vector = rotation_vector(np.eye(3), about(axis, np.pi))
    assert np.linalg.norm(vector) == pytest.approx(np.pi, abs=1e-4)
    np.testing.assert_allclose(about(vector, float(np.linalg.norm(vector))), about(axis, np.pi), atol=1e-4)


@given(AXIS, st.floats(-3, 3))
def test_a_turn_is_orthonormal_and_right_handed(axis, angle):
    turn = about(axis, angle)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)


@given(st.floats(-3, 3))
def test_a_hand_that_points_down_has_its_fingers_along_the_yaw(yaw):
    hand = hand_down(yaw)
    np.testing.assert_allclose(hand[:, 2], [0, 0, -1])
    np.testing.assert_allclose(hand[:, 1], [np.sin(yaw), -np.cos(yaw), 0])
    assert np.linalg.det(hand) == pytest.approx(1)


@given(AXIS, st.floats(0, 0.7), st.permutations([0, 1, 2]), st.tuples(*[st.sampled_from([-1, 1])] * 3))
def test_the_angle_to_a_box_does_not_care_which_axis_is_which(axis, angle, order, signs):
    box = np.diag(signs) @ np.eye(3)[order]
    box *= np.linalg.det(box)
    assert angle_to_box(about(axis, angle) @ box, np.eye(3)) == pytest.approx(
        angle_to_box(about(axis, angle), np.eye(3)), abs=1e-6
    )
    assert angle_to_box(about([0, 0, 1], angle), np.eye(3)) == pytest.approx(angle, abs=1e-6)


def test_the_greatest_angle_to_a_box_is_known():
    found = max(
        angle_to_box(about(axis, angle), np.eye(3))
        for axis in np.random.default_rng(0).normal(size=(400, 3))
        for angle in (0.8, 1.0, 1.1)
    )
    assert found < 1.0961  # 62.8 degrees, the greatest misorientation of cubes (Mackenzie 1958)


def test_an_angle_between_directions():
    assert angle_between(np.array([1, 0, 0]), np.array([0, 2, 0])) == pytest.approx(np.pi / 2)
    assert angle_between(np.array([1, 0, 0]), np.array([-3, 0, 0])) == pytest.approx(np.pi)


@pytest.mark.parametrize("angle", [0.0, 0.5, 3.1, np.pi])
def test_a_quaternion_turns_as_its_matrix_does(angle):
    x, y, z, w = quaternion_xyzw(about([1, 0, 0], angle))
    assert w >= 0
    np.testing.assert_allclose([abs(x), y, z, w], [np.sin(angle / 2), 0, 0, np.cos(angle / 2)], atol=1e-9)
    assert x * np.sin(angle) >= 0


@given(TURNS)
def test_the_matrices_of_quaternions_are_the_rotations_that_they_were_made_of(turns):
    quaternions = quaternion_xyzw(turns)
    np.testing.assert_allclose(matrices(quaternions), turns, atol=1e-12)
    np.testing.assert_array_equal(quaternions, [quaternion_xyzw(turn) for turn in turns])


@given(AXIS, st.floats(-np.pi, np.pi), st.floats(1e-3, 1e3), st.sampled_from([-1, 1]))
def test_neither_length_nor_sign_of_a_quaternion_turns_anything(axis, angle, length, sign):
    # By Euler's formula itself, w last.
    unit = np.array([*np.sin(angle / 2) * axis / np.linalg.norm(axis), np.cos(angle / 2)])
    np.testing.assert_allclose(matrices(sign * length * unit[None]), about(axis, angle)[None], atol=1e-12)


@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3), min_size=1, max_size=6))
def test_every_quaternion_gives_an_orthonormal_right_handed_matrix(quaternions):
    found = matrices(np.array(quaternions))
    assert found.shape == (len(quaternions), 3, 3)
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.broadcast_to(np.eye(3), found.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found), 1)


def test_quarter_turns_by_hand():
    half = np.sqrt(0.5)
    x_to_y, y_to_z = matrices(np.array([[0, 0, half, half], [half, 0, 0, half]]))
    np.testing.assert_allclose(x_to_y @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(y_to_z @ [0, 1, 0], [0, 0, 1], atol=1e-12)


@given(TURN, AXIS, st.lists(st.floats(-np.pi, np.pi), min_size=1, max_size=6))
def test_how_far_a_thing_is_turned_is_the_angle_that_it_was_turned_by(start, axis, angles):
    turned = np.array([about(axis, angle) @ start for angle in angles])
    # The arc cosine of a number with an error of 1e-16 is wrong by 1e-8 at most.
    np.testing.assert_allclose(turned_rad(turned, start), np.abs(angles), atol=1e-7)


@given(TURNS, TURN, TURN)
def test_how_far_a_thing_is_turned_depends_on_no_axes_and_no_direction(turns, start, other):
    turned = turned_rad(turns, start)
    assert turned.shape == (len(turns),)
    assert ((turned >= 0) & (turned <= np.pi)).all()
    np.testing.assert_allclose(turned_rad(other @ turns, other @ start), turned, atol=1e-6)  # other axes of the world
    np.testing.assert_allclose(turned_rad(turns @ other, start @ other), turned, atol=1e-6)  # other axes of the thing
    np.testing.assert_allclose([turned_rad(start[None], turn)[0] for turn in turns], turned, atol=1e-6)
    np.testing.assert_allclose(turned, [np.linalg.norm(rotation_vector(start, turn)) for turn in turns], atol=1e-6)
