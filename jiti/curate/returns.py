"""Monte-Carlo returns: G_t = r_t + gamma * G_{t+1}, with G = 0 behind the last frame of an episode."""

import math
from itertools import pairwise

import numpy as np

from jiti.errors import UsageError

GAMMA = 0.98
"""Discount factor. Stated for GR00T-N1.5 features, supplement C.4."""

_BLOCK = 256
"""Frames that are summed one after the other, in all blocks at once. Our choice: fast from 50 to 100,000 frames."""


def mc_returns(reward: np.ndarray, offsets: np.ndarray, gamma: float = GAMMA) -> np.ndarray:
    """Returns (frames,) float64 of rewards (frames,) of episodes that lie one behind the other.

    Episode `i` is frames `offsets[i]` to `offsets[i + 1] - 1`. Raises UsageError for a gamma outside 0 to 1.

    Each episode is cut into blocks from its end. Within blocks the recursion runs backwards, one step of all blocks at
    a time; then each block's last return is carried into the blocks before it. No power of gamma is divided
    by, so that nothing is lost for long episodes.
    """
    if not (math.isfinite(gamma) and 0 <= gamma <= 1):
        raise UsageError(f"gamma is {gamma}; it must be from 0 to 1. Pass --gamma {GAMMA}.")
    lengths = np.diff(offsets)
    blocks = -(-lengths // _BLOCK)
    episode = np.repeat(np.arange(len(lengths)), blocks)
    from_end = np.arange(len(episode)) - np.repeat(np.cumsum(blocks) - blocks, blocks)
    stop = offsets[1:][episode] - from_end * _BLOCK
    size = np.minimum(_BLOCK, lengths[episode] - from_end * _BLOCK)

    returns = np.asarray(reward, np.float64).copy()
    by_size = np.argsort(-size, kind="stable")
    last = stop[by_size] - 1
    at_least = np.searchsorted(-size[by_size], -np.arange(_BLOCK) - 1, side="right")
    for step in range(1, int(size.max(initial=0))):
        frame = last[: at_least[step]] - step
        returns[frame] += gamma * returns[frame + 1]

    powers = gamma ** np.arange(1, _BLOCK + 1, dtype=np.float64)
    by_place = np.argsort(from_end, kind="stable")
    places = np.searchsorted(from_end[by_place], np.arange(1, int(blocks.max(initial=0)) + 1))
    for begin, end in pairwise(places):
        block = by_place[begin:end]
        steps = np.arange(int(size[block].max()))
        inside = steps < size[block][:, None]
        frames = (stop[block][:, None] - 1 - steps)[inside]
        returns[frames] += (powers[steps] * returns[stop[block]][:, None])[inside]
    return returns
