"""How well Q ranks: satisfied segments over violated ones, by the value of what was done there.

A decided segment is a run of annotated frames with one reward. Its score is the mean, over those of its frames t from
which a whole chunk fits into the episode, of min_E Q(s_t, A_t), A_t the recorded actions t to t + K - 1; where no whole
chunk fits, of all its frames, with what is behind the end masked.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch  # noqa: TID253  imported by training and evaluation only

from jiti.critic.chunks import cut_chunks
from jiti.critic.critic import Critic
from jiti.critic.dataset import ElegantData
from jiti.critic.features.cache import FeatureCache
from jiti.errors import SourceError

BATCH = 512
"""Chunks valued at once. Our choice: tens of megabytes."""


@dataclass(frozen=True, slots=True)
class Decided:
    """A decided segment: frames `start` to `stop - 1` of the dataset's index."""

    episode: int
    task: str
    start: int
    stop: int
    elegant: bool


@dataclass(frozen=True, slots=True)
class Ranking:
    """AUC of scores, for each task and averaged over tasks."""

    auc: dict[str, float]
    """By task; only tasks with segments of both kinds."""
    counts: dict[str, tuple[int, int]]
    """By task: satisfied and violated segments."""

    @property
    def average(self) -> float:
        """Mean over tasks, each with the same weight; NaN without any."""
        return float(np.mean(list(self.auc.values()))) if self.auc else float("nan")


def decided_segments(data: ElegantData, episodes: np.ndarray) -> list[Decided]:
    """The decided segments of episodes, in order."""
    found = []
    for episode in episodes.tolist():
        first, stop = int(data.offsets[episode]), int(data.offsets[episode + 1])
        kind = np.where(data.annotated[first:stop], (data.reward[first:stop] > 0).astype(int), -1)
        edges = np.flatnonzero(np.diff(kind, prepend=-2, append=-2))
        for begin, end in pairwise(edges.tolist()):
            if kind[begin] >= 0:
                task = str(data.task[episode])
                found.append(Decided(episode, task, first + int(begin), first + int(end), bool(kind[begin])))
    return found


def frames_scored(data: ElegantData, segment: Decided, chunk: int) -> np.ndarray:
    """The frames whose values a segment's score is the mean of."""
    frames = np.arange(segment.start, segment.stop)
    whole = frames[frames + chunk <= data.offsets[segment.episode + 1]]
    return whole if len(whole) else frames


def check_sizes(critic: Critic, data: ElegantData, cache: FeatureCache, remedy: str) -> None:
    """Raises SourceError, with what to do, for features or actions of other sizes than the critic takes."""
    sizes = critic.sizes
    have, want = (cache.tokens, cache.size, data.action.shape[1]), (sizes.tokens, sizes.features, sizes.action)
    if have != want:
        raise SourceError(
            f"{data.root} gives features of {have[0]} x {have[1]} numbers and actions of {have[2]}; this critic takes "
            f"{want[0]} x {want[1]} and {want[2]}. {remedy}"
        )


def recorded_values(critic: Critic, data: ElegantData, cache: FeatureCache, frames: np.ndarray) -> np.ndarray:
    """min_E Q (n,) float32 of the recorded chunks that start at frames (n,)."""
    return member_values(critic, data, cache, frames).min(0)


def member_values(critic: Critic, data: ElegantData, cache: FeatureCache, frames: np.ndarray) -> np.ndarray:
    """Q of each member (E, n) float32 of the recorded chunks that start at frames (n,)."""
    parts = [np.zeros((critic.network.ensemble, 0), np.float32)]
    for begin in range(0, len(frames), BATCH):
        part = frames[begin : begin + BATCH]
        chunks = cut_chunks(data, part, chunk=critic.chunk, offset=1, gamma=data.gamma, limits=critic.limits)
        parts.append(chunk_values(critic, cache, part, chunks.action, chunks.mask))
    return np.concatenate(parts, axis=1)


@torch.no_grad()
def chunk_values(
    critic: Critic, cache: FeatureCache, frames: np.ndarray, action: np.ndarray, mask: np.ndarray
) -> np.ndarray:
    """Q of each member (E, n) float32 of chunks (n, K, A) in -1 to 1 with masks (n, K) at frames (n,)."""
    device = critic.q.scale.device
    chunks = torch.from_numpy(action).unsqueeze(1).to(device)
    q = critic.q(cache.read(frames).to(device), chunks, torch.from_numpy(mask).to(device))
    return q[:, :, 0].cpu().numpy()


def segment_scores(
    critic: Critic, data: ElegantData, cache: FeatureCache, segments: Sequence[Decided], *, earlier: int = 0
) -> np.ndarray:
    """Scores (n,) of segments; with `earlier`, of the same frames so many frames before, within the episode."""
    frames = [frames_scored(data, segment, critic.chunk) for segment in segments]
    if not frames:
        return np.zeros(0)
    moved = [
        np.maximum(part - earlier, data.offsets[segment.episode])
        for part, segment in zip(frames, segments, strict=True)
    ]
    values = recorded_values(critic, data, cache, np.concatenate(moved))
    return np.array([part.mean() for part in np.split(values, np.cumsum([len(part) for part in frames])[:-1])])


def rank(scores: np.ndarray, segments: Sequence[Decided]) -> Ranking:
    """AUC by task of scores (n,)."""
    tasks = np.array([segment.task for segment in segments], dtype=object)
    elegant = np.array([segment.elegant for segment in segments], dtype=bool)
    auc, counts = {}, {}
    for task in sorted(set(tasks.tolist())):
        here = tasks == task
        counts[task] = (int(elegant[here].sum()), int((~elegant[here]).sum()))
        if min(counts[task]):
            auc[task] = area_under_curve(scores[here], elegant[here])
    return Ranking(auc, counts)


def area_under_curve(scores: np.ndarray, positive: np.ndarray) -> float:
    """The share of pairs of a positive and a negative in which the positive scores higher; equal ones count half."""
    above = scores[positive][:, None] - scores[~positive][None]
    return float(((above > 0) + 0.5 * (above == 0)).mean())


def shuffled_rewards(data: ElegantData, seed: int) -> np.ndarray:
    """Rewards (frames,) with the verdicts of decided segments dealt anew among those of the same task."""
    reward = data.reward.copy()
    segments = decided_segments(data, np.flatnonzero(data.labelled))
    generator = np.random.default_rng(seed)
    for task in sorted({segment.task for segment in segments}):
        own = [segment for segment in segments if segment.task == task]
        for segment, place in zip(own, generator.permutation(len(own)), strict=True):
            reward[segment.start : segment.stop] = float(own[int(place)].elegant)
    return reward
