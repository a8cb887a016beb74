"""A dataset at a glance: every episode as one row of bins in normalised time, rewards and returns."""

from dataclasses import dataclass

import numpy as np

from jiti.curate.returns import mc_returns
from jiti.curate.rewards import FrameRewards

BINS = 120
"""Columns of a row. Our choice: a 300-frame episode in steps of about one tenth of a second."""

NOTHING, FAIL, PASS = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Glance:
    """Rows are episodes, in the order of the rewards."""

    bins: int
    states: np.ndarray
    """(episodes, bins) uint8: NOTHING, FAIL where any frame of the bin fails, PASS where frames pass and none fails."""
    returns: np.ndarray
    """(episodes, bins) uint8: the largest Monte-Carlo return in the bin, 255 at `return_max`."""
    return_max: float
    mean_return: np.ndarray
    """(episodes,) float64."""
    reward_share: np.ndarray
    """(episodes,) float64: share of frames with reward 1."""
    annotated_share: np.ndarray
    """(episodes,) float64: share of annotated frames."""


def glance(rewards: FrameRewards, gamma: float, bins: int = BINS) -> Glance:
    """Bin `b` of an episode of n frames covers frames floor(b n / bins) up to, and at least one past, that."""
    count = len(rewards.episode_ids)
    lengths = np.diff(rewards.offsets)
    returns = mc_returns(rewards.reward, rewards.offsets, gamma)
    state = np.where(rewards.annotated, np.where(rewards.reward > 0, PASS, FAIL), NOTHING).astype(np.uint8)
    # A failure outranks a pass, and a pass outranks nothing: 0 nothing, 1 pass, 2 fail, so that the maximum tells.
    rank = np.array([0, 2, 1], np.uint8)
    starts = rewards.offsets[:-1, None] + (np.arange(bins) * lengths[:, None]) // bins
    worst = rank[_bin_maxima(rank[state], starts, rewards.offsets)]
    top = float(returns.max(initial=0.0))
    largest = _bin_maxima(returns.astype(np.float32), starts, rewards.offsets)
    divide = np.maximum(lengths, 1)
    return Glance(
        bins=bins,
        states=worst,
        returns=np.rint(largest / top * 255).astype(np.uint8) if top > 0 else np.zeros((count, bins), np.uint8),
        return_max=top,
        mean_return=_sums(returns, rewards.offsets) / divide,
        reward_share=_sums(rewards.reward, rewards.offsets) / divide,
        annotated_share=_sums(rewards.annotated, rewards.offsets) / divide,
    )


def _bin_maxima(values: np.ndarray, starts: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(episodes, bins): the maximum from each bin's start to the next one's, or of one frame when they coincide."""
    if not values.size or not starts.size:
        return np.zeros(starts.shape, values.dtype)
    # reduceat gives the value at the start where two starts coincide, which is the one frame that is wanted.
    flat = np.append(starts.ravel(), offsets[-1])
    return np.maximum.reduceat(np.append(values, values[-1:]), flat)[:-1].reshape(starts.shape)


def _sums(values: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(episodes,) float64: the sum over each episode's frames."""
    total = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    return total[offsets[1:]] - total[offsets[:-1]]
