"""Per-frame rewards from segments: 1 where every ITC that is decided there is satisfied."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from jiti.curate.verdicts import Spans, spans


@dataclass(frozen=True, slots=True)
class FrameRewards:
    """The frames of many episodes, one episode behind the other."""

    episode_ids: list[str]
    offsets: np.ndarray
    """(episodes + 1,) int64: episode `i` is frames `offsets[i]` to `offsets[i + 1] - 1`."""
    reward: np.ndarray
    """(frames,) float32: 0 or 1; 0 where nothing is annotated."""
    annotated: np.ndarray
    """(frames,) bool: whether an ITC is decided there."""

    def frames(self, episode_id: str) -> slice:
        """Where an episode's frames are. Raises KeyError for one that is not there."""
        try:
            place = self.episode_ids.index(episode_id)
        except ValueError:
            raise KeyError(episode_id) from None
        return slice(int(self.offsets[place]), int(self.offsets[place + 1]))


def frame_rewards(segments: pa.Table, frame_counts: Mapping[str, int]) -> FrameRewards:
    """Rewards of every frame of the episodes in `frame_counts`, in its order, by `verdicts.RULE`.

    `segments` is a table of `read_segments`. An elegant frame satisfies every ITC, so its reward is the
    minimum over the ITCs that are decided there.
    """
    return rewards_of(spans(segments, frame_counts), frame_counts)


def rewards_of(found: Spans, frame_counts: Mapping[str, int]) -> FrameRewards:
    """As `frame_rewards`, from the spans of the same episodes."""
    offsets = np.concatenate([[0], np.cumsum(np.fromiter(frame_counts.values(), np.int64, len(frame_counts)))])
    first, stop = offsets[found.episode] + found.start, offsets[found.episode] + found.end + 1
    failed = found.verdict == 0
    annotated = _any(first, stop, int(offsets[-1]))
    reward = annotated & ~_any(first[failed], stop[failed], int(offsets[-1]))
    return FrameRewards(found.episode_ids, offsets, reward.astype(np.float32), annotated)


def _any(first: np.ndarray, stop: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: frames that lie in any of the runs `first` to `stop - 1`."""
    steps = np.bincount(first, minlength=count + 1) - np.bincount(stop, minlength=count + 1)
    return np.cumsum(steps[:count]) > 0
