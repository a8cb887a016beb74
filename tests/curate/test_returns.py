"""Returns by hand, against the naive recursion, and by their algebra."""

import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.curate.returns import GAMMA, mc_returns
from jiti.errors import UsageError


def naive(reward: np.ndarray, offsets: np.ndarray, gamma: float) -> np.ndarray:
    out = np.zeros(len(reward))
    for start, stop in pairwise(offsets):
        following = 0.0
        for frame in range(stop - 1, start - 1, -1):
            following = out[frame] = float(reward[frame]) + gamma * following
    return out


def test_by_hand() -> None:
    returns = mc_returns(np.array([0, 0, 1, 1, 0], np.float32), np.array([0, 5]), 0.5)
    assert returns.tolist() == [0.375, 0.75, 1.5, 1.0, 0.0]
    assert returns.dtype == np.float64


def test_nothing_flows_from_one_episode_into_the_one_before() -> None:
    returns = mc_returns(np.array([0, 0, 1, 0, 1]), np.array([0, 2, 2, 5]), 0.5)
    assert returns.tolist() == [0, 0, 1.25, 0.5, 1]


def test_a_long_run_of_ones_is_the_geometric_series() -> None:
    frames = 1000
    returns = mc_returns(np.ones(frames), np.array([0, frames]), GAMMA)
    left = np.arange(frames, 0, -1)
    assert returns == pytest.approx((1 - GAMMA**left) / (1 - GAMMA), rel=1e-12)
    assert returns[0] == pytest.approx(50, rel=1e-8)


@pytest.mark.parametrize("lengths", [[], [0], [0, 0, 3, 0], [256], [257], [255, 1, 512, 513, 2], [5000, 1, 300]])
@pytest.mark.parametrize("gamma", [0.0, 0.5, GAMMA, 1.0])
def test_lengths_around_the_block_size(lengths: list[int], gamma: float) -> None:
    offsets = np.concatenate([[0], np.cumsum(np.array(lengths, np.int64))])
    reward = np.random.default_rng(1).random(offsets[-1])
    assert mc_returns(reward, offsets, gamma) == pytest.approx(naive(reward, offsets, gamma), rel=1e-12, abs=1e-300)


@settings(deadline=None)
@given(
    st.lists(st.lists(st.floats(-1, 1), max_size=40) | st.integers(0, 900), max_size=8),
    st.floats(0, 1),
)
def test_agrees_with_the_recursion(episodes: list[list[float] | int], gamma: float) -> None:
    rewards = [np.array(e) if isinstance(e, list) else np.random.default_rng(e).integers(0, 2, e) for e in episodes]
    offsets = np.concatenate([[0], np.cumsum([len(r) for r in rewards], dtype=np.int64)]).astype(np.int64)
    reward = np.concatenate([np.empty(0), *rewards])
    returns = mc_returns(reward, offsets, gamma)
    assert returns == pytest.approx(naive(reward, offsets, gamma), rel=1e-9, abs=1e-9)
    inner = np.setdiff1d(np.arange(len(reward) - 1), offsets[1:] - 1)  # frames with a next one
    assert returns[inner] == pytest.approx(reward[inner] + gamma * returns[inner + 1], rel=1e-9, abs=1e-9)
    doubled = mc_returns(2 * reward, offsets, gamma)
    assert doubled == pytest.approx(2 * returns, rel=1e-9, abs=1e-9)


def test_the_rewards_are_left_as_they_were() -> None:
    reward = np.ones(300)
    mc_returns(reward, np.array([0, 300]))
    assert (reward == 1).all()


@pytest.mark.parametrize("gamma", [-0.1, 1.1, float("nan"), float("inf")])
def test_a_gamma_that_is_none_names_the_flag(gamma: float) -> None:
    with pytest.raises(UsageError, match=r"gamma is .*from 0 to 1\. Pass --gamma 0\.98"):
        mc_returns(np.ones(3), np.array([0, 3]), gamma)


@pytest.mark.parametrize("offsets", [np.arange(0, 3_000_001, 300), np.array([0, 3_000_000])])
def test_three_million_frames_take_no_time(offsets: np.ndarray) -> None:
    reward = np.random.default_rng(0).random(3_000_000)
    begin = time.process_time()
    returns = mc_returns(reward, offsets)
    assert time.process_time() - begin < 2  # 0.1 to 0.2 s; the recursion in Python takes longer
    assert returns[-1] == reward[-1]
