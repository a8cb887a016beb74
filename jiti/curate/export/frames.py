"""The frames of the dataset in each recording: the recording's own, or those of a new clock at a fixed rate."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from jiti.annotate.segments import Segment
from jiti.episodes.clock import Clock, fixed_rate
from jiti.errors import UsageError

RATE_TOLERANCE = 0.02
"""Share by which a recording's median rate may differ from a whole number. Our choice: 30 Hz are often 29.97."""
SLACK_NS = 1000
"""A sample this much later than a frame still belongs to it. Our choice: times are rounded to nanoseconds twice."""


@dataclass(frozen=True, slots=True)
class Frames:
    """The dataset's frames of one episode."""

    time_ns: np.ndarray
    """(N,) int64 in the recording's clock: what numbers are held at."""
    recorded: np.ndarray
    """(N,) int64, non-decreasing: the frame of the recording that each one shows."""
    resampled: bool

    @property
    def count(self) -> int:
        return len(self.time_ns)

    def hold(self, time_ns: np.ndarray) -> np.ndarray:
        """Index of the latest sample at or before each frame, -1 before the first: (N,) int64."""
        return np.searchsorted(time_ns, self.time_ns + SLACK_NS, side="right") - 1


def whole_rate(rate_hz: float, title: str) -> int:
    """A recording's rate as LeRobot stores it. Raises UsageError for one that is no whole number."""
    nearest = round(rate_hz)
    if nearest < 1 or abs(rate_hz - nearest) > RATE_TOLERANCE * nearest:
        raise UsageError(
            f"{title} runs at {rate_hz:.4g} Hz; LeRobot's rates are whole numbers. Pass --fps {max(1, nearest)} to "
            "resample."
        )
    return nearest


def frames_of(clock: Clock, fps: int | None) -> Frames:
    """The recording's frames, or with `fps` those of a new clock from its first frame to its last."""
    if fps is None:
        return Frames(clock.frame_ns, np.arange(clock.frame_count), resampled=False)
    start, end = int(clock.frame_ns[0]), int(clock.frame_ns[-1])
    time_ns = fixed_rate(start, end + SLACK_NS, fps).frame_ns
    recorded = np.searchsorted(clock.frame_ns, time_ns + SLACK_NS, side="right") - 1
    return Frames(time_ns, recorded, resampled=True)


def moved(segments: Iterable[Segment], frames: Frames, episode_id: str, fps: int) -> list[Segment]:
    """Segments on the dataset's frames: those that show a frame of the segment, at least one.

    Times are those that our LeRobot reader gives: frame / fps, from 0.
    """
    found = []
    for segment in segments:
        start = int(np.searchsorted(frames.recorded, segment.start_frame, side="left"))
        end = int(np.searchsorted(frames.recorded, segment.end_frame, side="right")) - 1
        start = min(start, frames.count - 1)
        end = max(start, end)
        found.append(
            replace(
                segment,
                episode_id=episode_id,
                start_frame=start,
                end_frame=end,
                start_ns=round(start * (1e9 / fps)),
                end_ns=round(end * (1e9 / fps)),
                status="accepted",
            )
        )
    return found
