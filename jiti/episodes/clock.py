"""The reference clock of an episode: which frame is when, and what other streams showed at it."""

from dataclasses import dataclass

import numpy as np

FIXED_RATE_HZ = 30.0
"""Frame rate of an episode without a camera. Our choice: LeRobot's and the paper's recordings run at 20 to 30 Hz."""

JUMP_NS = 500_000_000
"""A step back by more than this is a clock that was set; a smaller one is messages out of order. Our choice."""


@dataclass(frozen=True, slots=True)
class Clock:
    """Frame numbers of an episode. Frame `i` is shown, stored and exported as `i`."""

    reference: str | None
    """The camera whose pictures are the frames; None for a fixed rate."""
    frame_ns: np.ndarray
    """(frame_count,) int64, non-decreasing: the time of each frame in the recording's clock."""

    @property
    def frame_count(self) -> int:
        return len(self.frame_ns)

    @property
    def display_ns(self) -> np.ndarray:
        """(frame_count,) int64 from 0, strictly increasing: frames with equal stamps are 1 ns apart."""
        steps = np.arange(self.frame_count, dtype=np.int64)
        return np.maximum.accumulate(self.frame_ns - self.frame_ns[:1] - steps) + steps

    @property
    def duration_ns(self) -> int:
        return int(self.frame_ns[-1] - self.frame_ns[0]) if self.frame_count else 0

    @property
    def rate_hz(self) -> float:
        """Median frame rate; the fixed rate when fewer than two frames or no time passes."""
        period = float(np.median(np.diff(self.frame_ns))) if self.frame_count > 1 else 0.0
        return 1e9 / period if period > 0 else FIXED_RATE_HZ

    def hold(self, time_ns: np.ndarray) -> np.ndarray:
        """Index of the latest sample at or before each frame, -1 before the first: (frame_count,) int64."""
        return np.searchsorted(time_ns, self.frame_ns, side="right") - 1

    def late_frames(self, time_ns: np.ndarray, tolerance_ns: int) -> np.ndarray:
        """Frames whose held sample is missing or older than the tolerance: (n,) int64."""
        if not len(time_ns):
            return np.arange(self.frame_count)
        held = self.hold(time_ns)
        age_ns = self.frame_ns - time_ns[np.maximum(held, 0)]
        return np.flatnonzero((held < 0) | (age_ns > tolerance_ns))


def fixed_rate(start_ns: int, end_ns: int, rate_hz: float = FIXED_RATE_HZ) -> Clock:
    """Frames at a fixed rate from `start_ns` to `end_ns`, both inclusive where they fall on a frame."""
    count = int((end_ns - start_ns) * rate_hz / 1e9) + 1
    return Clock(None, start_ns + np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64))


def unwrap(time_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undo clock jumps in one stream, given in recording order.

    Returns the times (N,) int64, non-decreasing after a stable sort of small disorder, and the
    indices at which the clock was set back by more than `JUMP_NS`. After a jump the stream goes on one
    median period after the latest time before it, so that video stays decodable and nothing overlaps.
    """
    steps = np.diff(time_ns)
    jumps = np.flatnonzero(steps < -JUMP_NS) + 1
    if len(jumps):
        period = int(np.median(steps[steps > 0])) if (steps > 0).any() else 1
        time_ns = time_ns.copy()
        for jump in jumps:
            time_ns[jump:] += time_ns[:jump].max() + period - time_ns[jump]
    return time_ns, jumps
