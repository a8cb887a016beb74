"""The reference clock of an episode: which frame is when, and what other streams showed at it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FIXED_RATE_HZ = 30.0
"""Frame rate of an episode without a camera. Our choice: LeRobot's and the paper's recordings run at 20 to 30 Hz."""

JUMP_NS = 500_000_000
"""A step back by more than this is a clock that was set; a smaller one is messages out of order. Our choice."""

FEW = 3
"""So many messages in a row may be late, or ahead of their time, without the clock having been set. Our choice."""


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

    Returns the times (N,) int64, which a stable sort brings in order, and the indices at which the clock was set
    back by more than `JUMP_NS`. After a jump the stream goes on one median period after the latest time before it,
    so that video stays decodable and nothing overlaps. Not jumps, and left to the sort: a few late messages, and
    stretches that were recorded out of order. A few messages ahead of their time are moved to the one before them.
    """
    times, jumps, offsets = _jumps(time_ns)
    return _shift(times, jumps, offsets), jumps


def unwrap_together(
    streams: Sequence[np.ndarray], positions: Sequence[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Undo clock jumps in streams of one recording by the same amounts, so that they stay aligned.

    `positions` (N,) int64 a stream grow in recording order over all streams. Returns what `unwrap` does, a stream.
    A jump is measured in the stream with the most messages; one that shows another number of jumps (it starts
    late, or has few messages) is shifted where those of the first lie in the recording.
    """
    found = [_jumps(time_ns) for time_ns in streams]
    jumping = [k for k, (_, jumps, _) in enumerate(found) if len(jumps)]
    if not jumping:
        return [(times, jumps) for times, jumps, _ in found]
    dense = max(jumping, key=lambda k: len(streams[k]))
    _, dense_jumps, dense_offsets = found[dense]
    unwrapped = []
    for (times, jumps, offsets), place in zip(found, positions, strict=True):
        if len(jumps) == len(dense_jumps):
            unwrapped.append((_shift(times, jumps, np.maximum(offsets, dense_offsets)), jumps))
        else:
            at = np.searchsorted(place, positions[dense][dense_jumps])
            unwrapped.append((_shift(times, at, dense_offsets), jumps))
    return unwrapped


def _jumps(time_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times without messages ahead of their time, indices of jumps, and what to add from each one on."""
    none = np.empty(0, np.int64)
    back = np.flatnonzero(np.diff(time_ns) < -JUMP_NS) + 1
    if not len(back) or stretches_in_order(time_ns) is not None:
        return time_ns, none, none
    times, jumps = time_ns.copy(), []
    for index in back.tolist():
        before = int(times[index - 1])
        if (times[index + 1 : index + 1 + FEW] >= before - JUMP_NS).any():
            continue  # the clock is soon back where it was: these messages are late
        jumps.append(index)
        ahead = np.flatnonzero(times[max(0, index - 1 - FEW) : index - 1] <= times[index])
        if len(ahead):
            last = max(0, index - 1 - FEW) + int(ahead[-1])
            if times[last + 1] - times[last] > JUMP_NS:
                times[last + 1 : index] = times[last]
    steps = np.diff(times)
    period = int(np.median(steps[steps > 0])) if (steps > 0).any() else 1
    latest, offset, offsets = None, 0, []
    for start, end in zip([0, *jumps], [*jumps, len(times)], strict=True):
        if latest is not None and times[start] + offset <= latest - JUMP_NS:
            offset = latest + period - int(times[start])
        if start:
            offsets.append(offset)
        top = int(times[start:end].max()) + offset
        latest = top if latest is None else max(latest, top)
    return times, np.array(jumps, np.int64), np.array(offsets, np.int64)


def _shift(time_ns: np.ndarray, jumps: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    if not len(jumps):
        return time_ns
    added = np.concatenate([[0], offsets]).astype(np.int64)
    return time_ns + added[np.searchsorted(jumps, np.arange(len(time_ns)), side="right")]


def stretches_in_order(time_ns: np.ndarray) -> np.ndarray | None:
    """Indices (N,) that bring stretches which were recorded out of order in order of time, each left as it is.

    None where there are none: where steps over `JUMP_NS` do not part the times into stretches that fill one span
    without overlap or gap.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(time_ns)) > JUMP_NS) + 1])
    if len(starts) < 2:
        return None
    first, last = np.minimum.reduceat(time_ns, starts), np.maximum.reduceat(time_ns, starts)
    order = np.argsort(first, kind="stable")
    gaps = first[order][1:] - last[order][:-1]
    if (gaps < 0).any() or (gaps > JUMP_NS).any():
        return None
    parts = np.split(np.arange(len(time_ns)), starts[1:])
    return np.concatenate([parts[k] for k in order])
