"""Rotations in their several forms, against what they must satisfy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.tasks.rotation import about, angle_between, angle_to_box, hand_down, quaternion_xyzw, rotation_vector

AXIS = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)


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
