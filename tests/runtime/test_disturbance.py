"""Pushes are as strong and as long as is said, on the translation alone, and what is recorded is what was wanted."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.episodes.episode import numbers
from jiti.episodes.reader import open_reader
from jiti.runtime.sim.disturbance import PUSH_EVERY_STEPS, PUSH_STEPS, Disturbance
from jiti.runtime.sim.record import Plan, record, recorded_metadata
from jiti.tasks.catalogue import load_catalogue

WANTED = np.array([0.2, -0.1, 0.3, 0.05, 0.0, -0.5, 1.0])


def executed(strongest: float, seed: int, steps: int, wanted: np.ndarray = WANTED) -> np.ndarray:
    disturbed = Disturbance(strongest, np.random.default_rng(seed))
    return np.array([disturbed(wanted) for _ in range(steps)])


@given(st.floats(0.01, 1.0), st.integers(0, 2**31))
def test_pushes_are_of_the_translation_and_no_stronger_than_is_said(strongest, seed):
    done = executed(strongest, seed, 200)
    assert (done[:, 3:] == WANTED[3:]).all()
    assert np.linalg.norm(done[:, :3] - WANTED[:3], axis=1).max() <= strongest + 1e-12
    assert np.abs(executed(strongest, seed, 200, np.ones(7))).max() <= 1


@given(st.integers(0, 2**31))
def test_a_push_is_constant_and_lasts_as_long_as_is_said(seed):
    pushes = executed(0.3, seed, 400)[:, :3] - WANTED[:3]
    began = np.flatnonzero(np.abs(np.diff(pushes, axis=0, prepend=1.0)).max(1) > 1e-12)
    lengths = np.diff(np.append(began, len(pushes)))
    pushed = np.abs(pushes[began]).max(1) > 0
    assert (lengths[:-1][pushed[:-1]] == PUSH_STEPS).all()


def test_pushes_come_as_often_as_is_said():
    pushes = executed(0.3, 0, 400_000)[:, :3] - WANTED[:3]
    assert np.mean(np.abs(pushes).max(1) > 0) == pytest.approx(PUSH_STEPS / PUSH_EVERY_STEPS, rel=0.02)
    assert np.abs(pushes.mean(0)).max() < 0.003


def test_without_strength_an_action_is_what_it_was():
    assert (executed(0.0, 0, 100) == WANTED).all()


@pytest.mark.sim
def test_the_expert_makes_pushes_good_and_what_it_wanted_is_recorded(tmp_path):
    plan = Plan(load_catalogue().task("elegant/T0"), quality=1.0, seed=3, cameras=())
    pushed = replace(plan, disturbance=0.3)
    (calm,) = record(plan, tmp_path / "calm", episodes=1)
    (one,) = record(pushed, tmp_path / "one", episodes=1)
    (again,) = record(pushed, tmp_path / "again", episodes=1)
    assert one.elegant
    assert recorded_metadata(one.path)["disturbance"] == "0.3"
    (hand_m, wanted), (other_m, others) = (way(path) for path in (calm.path, one.path))
    assert all((a == b).all() for a, b in zip(way(again.path), (other_m, others), strict=True))
    shared = min(len(wanted), len(others))
    apart = np.flatnonzero(np.linalg.norm(hand_m[:shared] - other_m[:shared], axis=1) > 1e-6)
    # The hand is somewhere else before anything else was wanted: pushes are not recorded as if they were.
    first = int(apart[0])
    assert (wanted[:first] == others[:first]).all()
    assert np.linalg.norm(hand_m[first:shared] - other_m[first:shared], axis=1).max() > 0.005


def way(path):
    """Where the hand was (T, 3), and the actions that were wanted (T, 7)."""
    reader = open_reader(path)
    episode = reader.open(reader.episodes()[0].episode_id)
    return numbers(episode, "/eef_pose")[1][:, :3], numbers(episode, "/action")[1]
