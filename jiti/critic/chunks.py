"""Chunks of actions cut from episodes, their n-step rewards, and the order in which training sees them.

Everything here is a function of frame numbers and of (seed, step): a run that goes on after a stop needs no state of a
sampler to see what it would have seen.
"""

from dataclasses import dataclass

import numpy as np

from jiti.critic.dataset import ElegantData

RANGE_MARGIN = 1e-3
"""Actions are mapped to at most 1 minus this, where a tanh's density is still finite. Our choice."""


@dataclass(frozen=True, slots=True)
class Chunks:
    """B chunks: what was done from frame t on, and what came of it. Arrays, one row a chunk."""

    action: np.ndarray
    """(B, K, A) float32: a_t to a_{t+K-1}, in -1 to 1; zeros behind the episode's end."""
    mask: np.ndarray
    """(B, K) bool: false behind the episode's end."""
    reward: np.ndarray
    """(B,) float32: the sum of gamma^i r_{t+i} for i < n, to the episode's end."""
    discount: np.ndarray
    """(B,) float32: gamma^n, or 0 where the episode ends before t + n: what follows is not bootstrapped."""
    next_frame: np.ndarray
    """(B,) int64: t + n, or t where the episode ends before (any frame does: `discount` is 0)."""
    next_mask: np.ndarray
    """(B, K) bool: the mask of a chunk that starts at `next_frame`."""
    mc_return: np.ndarray
    """(B,) float32: V^mu of frame t."""


@dataclass(frozen=True, slots=True)
class ActionRange:
    """The least and the greatest of each action in the training episodes, which become -1 and 1."""

    low: np.ndarray
    high: np.ndarray

    def to_unit(self, action: np.ndarray) -> np.ndarray:
        """Actions (..., A) in the recording's units to -1 to 1; what was never seen in training is clipped."""
        half = np.maximum((self.high - self.low) / 2, 1e-6)
        unit = (action - (self.low + self.high) / 2) / half
        return np.clip(unit, -1 + RANGE_MARGIN, 1 - RANGE_MARGIN).astype(np.float32)


def action_range(data: ElegantData, episodes: np.ndarray) -> ActionRange:
    """The range of the actions of these episodes."""
    action = data.action[data.frames_of(episodes)]
    return ActionRange(action.min(0), action.max(0))


def cut_chunks(
    data: ElegantData, frames: np.ndarray, *, chunk: int, offset: int, gamma: float, limits: ActionRange
) -> Chunks:
    """The chunks of `chunk` actions that start at `frames` (B,), with rewards over `offset` frames."""
    end = data.offsets[data.episode_of[frames] + 1]
    steps = np.arange(chunk)
    mask = frames[:, None] + steps < end[:, None]
    places = np.minimum(frames[:, None] + steps, end[:, None] - 1)
    action = np.where(mask[:, :, None], limits.to_unit(data.action[places]), np.float32(0))

    ahead = np.arange(offset)
    inside = frames[:, None] + ahead < end[:, None]
    rewards = data.reward[np.minimum(frames[:, None] + ahead, end[:, None] - 1)]
    reward = (inside * rewards * gamma**ahead).sum(1)
    follows = frames + offset < end
    next_frame = np.where(follows, frames + offset, frames)
    return Chunks(
        action=action,
        mask=mask,
        reward=reward.astype(np.float32),
        discount=np.where(follows, gamma**offset, 0).astype(np.float32),
        next_frame=next_frame,
        next_mask=next_frame[:, None] + steps < end[:, None],
        mc_return=data.mc_return[frames],
    )


def reaching_frames(data: ElegantData, frames: np.ndarray, chunk: int) -> np.ndarray:
    """Those of `frames` (n,) whose chunk of `chunk` actions reaches into a decided segment."""
    end = data.offsets[data.episode_of[frames] + 1]
    decided_before = np.concatenate([[0], np.cumsum(data.annotated)])
    return frames[decided_before[np.minimum(frames + chunk, end)] > decided_before[frames]]


class BatchOrder:
    """Which frames each step takes: a share of them from those that reach into decided segments, the rest from all."""

    def __init__(self, frames: np.ndarray, reaching: np.ndarray, batch: int, share: float, seed: int) -> None:
        chosen = round(share * batch) if len(reaching) else 0
        self._parts = (_Passes(frames, batch - chosen, (seed, 0)), _Passes(reaching, chosen, (seed, 1)))

    def step(self, step: int) -> np.ndarray:
        """The frames (batch,) of a step, counted from 0; a function of its number and the seed alone."""
        return np.concatenate([part.step(step) for part in self._parts])


class _Passes:
    """Pass after pass over frames, each in an order of its own, `count` of them a step."""

    def __init__(self, frames: np.ndarray, count: int, seed: tuple[int, int]) -> None:
        self._frames, self._count, self._seed = frames, count, seed
        self._orders: dict[int, np.ndarray] = {}

    def step(self, step: int) -> np.ndarray:
        at = np.arange(step * self._count, (step + 1) * self._count)
        passes, places = np.divmod(at, max(1, len(self._frames)))
        self._orders = {number: self._order(number) for number in np.unique(passes).tolist()}
        taken = [self._orders[number][place] for number, place in zip(passes.tolist(), places, strict=True)]
        return np.array(taken, np.int64)

    def _order(self, number: int) -> np.ndarray:
        known = self._orders.get(number)
        return np.random.default_rng((*self._seed, number)).permutation(self._frames) if known is None else known
