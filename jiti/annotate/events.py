"""What happened in an episode by its numbers alone: grippers that open and close, stops, contacts that begin and end.

Everything is found on the frames of the episode's clock, so that an event's frame is one that can be shown and marked.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from jiti.annotate.channels import METRES, Channel, find_channels
from jiti.episodes.clock import Clock
from jiti.episodes.episode import Episode, samples

EventKind = Literal["gripper_close", "gripper_open", "velocity_zero", "contact_on", "contact_off"]

GRIPPER_SWING = 0.3
"""Share of a gripper's whole travel that it must move back before it counts as turned. Our choice: a hand that holds
something soft gives and takes a tenth, a release moves by half or more."""

FORCE_SWING = 0.3
"""The same for contacts and forces. Our choice."""

STOP_RATIO = 3.0
"""Speed must fall to a third of the peaks on both sides to count as a stop. Our choice."""

SPEED_FLOOR = 0.05
"""Share of the 95th percentile of speed under which all speeds count as rest. Our choice."""

STEP_S = 0.2
"""Time in which a sharp transition is over, in seconds. Our choice: parallel grippers close in 0.1 to 0.5 s."""

REST_S = 0.5
"""A stop longer than this, in seconds, is two events: where the motion ends and where it begins again. Our choice."""

SMOOTH_S = 0.15
"""Places are averaged over this before speeds are taken, in seconds. Our choice: hands tremble at 8 to 12 Hz."""

MERGE_S = 0.25
"""Events of one kind and side in two streams, closer than this in seconds, are one event. Our choice."""

IDLE_SHARE = 0.2
"""An arm or hand that moves by less than this share of its busiest peer is idle. Our choice."""

NOISE = 12.0
"""A signal that travels less than this many standard deviations of its noise says nothing. Our choice: 100,000 samples
of pure noise span 9."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at one frame."""

    frame: int
    """First frame at which the new state is the nearer one."""
    kind: EventKind
    stream: str
    sharpness: float
    """0 to 1. Of a transition: the share of the whole travel that happens within `STEP_S`. Of a stop: how deep the
    speed falls, times the speed it falls from as a share of the episode's high speed."""
    side: str = ""
    """`left` or `right` where the recording names it."""


type Events = tuple[Event, ...]
"""In the order of their frames."""


def find_events(episode: Episode) -> Events:
    """All events of an episode, in one pass over the numeric streams that matter; none where none can be told."""
    channels = find_channels(episode.streams)
    read = samples(episode, dict.fromkeys(channel.stream for channel in channels))
    clock = episode.clock
    signals: dict[Channel, tuple[int, np.ndarray]] = {}
    for channel in channels:
        time_ns, values = read[channel.stream]
        if len(time_ns):
            raw = values[:, channel.columns]
            first, signal = _on_frames(clock, time_ns, raw, interpolate=channel.role == "motion")
            if len(signal) >= 3:
                signals[channel] = first, signal
    found = [
        Event(first + frame, kind, channel.stream, round(sharpness, 3), channel.side)
        for channel, (first, signal) in signals.items()
        if not _is_idle(channel, {c: s for c, (_, s) in signals.items()})
        for frame, kind, sharpness in _of_channel(channel, signal, clock.rate_hz)
    ]
    return _merged(found, clock.rate_hz)


def _on_frames(clock: Clock, time_ns: np.ndarray, raw: np.ndarray, *, interpolate: bool) -> tuple[int, np.ndarray]:
    """A channel on the frames between its first and last sample: first frame, values (n, columns) without NaN.

    States are held, places are interpolated, so that a stream slower than the camera does not seem to stop. Columns
    that are mostly NaN are left out, then samples that have one.
    """
    raw = raw[:, np.isfinite(raw).mean(axis=0) > 0.5]
    good = np.isfinite(raw).all(axis=1)
    time_ns, raw = time_ns[good], raw[good]
    if not raw.size:
        return 0, np.empty((0, 0))
    first, end = (int(k) for k in np.searchsorted(clock.frame_ns, (time_ns[0], time_ns[-1] + 1)))
    frame_ns = clock.frame_ns[first:end]
    if interpolate:
        since = (time_ns - time_ns[0]).astype(np.float64)
        at = (frame_ns - time_ns[0]).astype(np.float64)
        return first, np.stack([np.interp(at, since, column) for column in raw.T], axis=1)
    return first, raw[np.searchsorted(time_ns, frame_ns, side="right") - 1]


def _is_idle(channel: Channel, signals: dict[Channel, np.ndarray]) -> bool:
    """Whether this arm or hand hardly moves while another in the same stream does: an idle arm only trembles."""
    peers = [c for c in signals if (c.role, c.stream) == (channel.role, channel.stream)]
    travel = {c: float(np.linalg.norm(np.ptp(_despiked(signals[c], 3), axis=0))) for c in peers}
    return travel[channel] < IDLE_SHARE * max(travel.values())


def _of_channel(channel: Channel, signal: np.ndarray, rate_hz: float) -> Iterator[tuple[int, EventKind, float]]:
    """Frame within the signal, kind and sharpness of each event of one channel."""
    if channel.role == "motion":
        return _stops(signal, rate_hz)
    if channel.role == "gripper":
        return _transitions(gripper_opening(channel, signal), GRIPPER_SWING, rate_hz, "gripper_open", "gripper_close")
    raw = np.linalg.norm(signal, axis=1)
    size = _despiked(raw[:, None], 5)[:, 0]
    size = (size - size.min()) / np.ptp(size) if np.ptp(size) > NOISE * _noise(raw) else np.empty(0)
    return _transitions(size, FORCE_SWING, rate_hz, "contact_on", "contact_off")


def gripper_opening(channel: Channel, signal: np.ndarray) -> np.ndarray:
    """How open a gripper is, from its components (n, columns).

    Returns (n,) from 0, the most closed in this episode, to 1; empty if it never really moves. Two fingers are added
    up; the joints of a hand are reduced to the one direction in which they vary most. Where names do not say which way
    is open, the hand is open at the ends of the episode, its start counting more.
    """
    noise = np.array([_noise(column) for column in signal.T])
    signal = _despiked(signal, 3)
    reach = np.abs(signal).max(axis=0)
    travel = np.ptp(signal, axis=0)
    # Encoders jitter: a finger must move by 2 mm, a motor by 0.05 rad or per cent, and by a twentieth of where it is.
    least = np.maximum(np.where(reach <= METRES, 0.002, 0.05), 0.05 * reach)
    # Nor does a joint count that moves by a tenth of what its neighbours do.
    moving = (travel >= least) & (travel > NOISE * noise) & (travel > 0.1 * travel.max())
    if not moving.any():
        return np.empty(0)
    opens = channel.opens
    signal = signal[:, moving]
    if reach.max() <= METRES:
        opening = np.abs(signal).sum(axis=1)
        opens = "up" if opens == "unknown" else opens
    elif signal.shape[1] == 1:
        opening = signal[:, 0]
    else:
        scaled = (signal - signal.mean(axis=0)) / travel[moving]
        opening = scaled @ np.linalg.svd(scaled, full_matrices=False)[2][0]
    low, high = opening.min(), opening.max()
    if high <= low:
        return np.empty(0)
    opening = (opening - low) / (high - low)
    if opens == "down" or (opens == "unknown" and 0.6 * opening[0] + 0.4 * opening[-1] < 0.5):
        opening = 1 - opening
    return opening


def _transitions(
    signal: np.ndarray, swing: float, rate_hz: float, rising: EventKind, falling: EventKind
) -> Iterator[tuple[int, EventKind, float]]:
    """Rises and falls of a signal in 0 to 1, each at the middle of its steepest `STEP_S`."""
    pivots = turning_points(signal, swing)
    width = max(1, round(STEP_S * rate_hz))
    for start, end in pairwise(pivots):
        sign = 1.0 if signal[end] > signal[start] else -1.0
        at = np.arange(start, end)
        change = sign * (signal[np.minimum(at + width, end)] - signal[at])
        steepest = start + int(change.argmax())
        done = sign * (signal[steepest : end + 1] - signal[steepest])
        frame = steepest + int(np.argmax(done >= change.max() / 2))
        yield frame, rising if sign > 0 else falling, float(np.clip(change.max(), 0, 1))


def _stops(place: np.ndarray, rate_hz: float) -> Iterator[tuple[int, EventKind, float]]:
    """Minima of speed of a place (n, dimensions), and the ends of long rests."""
    place = _despiked(place, 3)
    smooth = _averaged(place, max(3, round(SMOOTH_S * rate_hz) | 1))
    noise = 1.4826 * np.median(np.abs(place - smooth), axis=0)
    if not (np.ptp(smooth, axis=0) > NOISE * noise).any():
        return
    speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=1)
    high = float(np.percentile(speed, 95))
    if high <= 0:
        return
    speed = np.minimum(speed / high, 1.0)
    pivots = turning_points(np.log(speed + SPEED_FLOOR), float(np.log(STOP_RATIO)))
    for k, pivot in enumerate(pivots):
        beside = [float(speed[pivots[j]]) for j in (k - 1, k + 1) if 0 <= j < len(pivots)]
        if not beside or min(beside) <= speed[pivot]:
            continue
        sharpness = min(beside) - float(speed[pivot])
        fast = np.flatnonzero(speed > 2 * speed[pivot] + SPEED_FLOOR)
        arrive, leave = int(fast[fast < pivot].max(initial=-1)) + 1, int(fast[fast > pivot].min(initial=len(speed))) - 1
        inner = [f for f in (arrive, leave) if 0 < f < len(speed) - 1]
        long = leave - arrive > REST_S * rate_hz or len(inner) < 2
        for frame in inner if long else [pivot]:
            yield frame, "velocity_zero", sharpness


def turning_points(signal: np.ndarray, swing: float) -> list[int]:
    """Indices of alternating lows and highs of a signal (n,), each at least `swing` from the next; [] without any.

    This is hysteresis that follows the signal: after a high, only a fall by `swing` from it counts, wherever it stood.
    """
    pivots: list[int] = []
    values = signal.tolist()
    low = high = 0
    rising: bool | None = None
    for k, value in enumerate(values):
        if value > values[high]:
            high = k
        if value < values[low]:
            low = k
        if rising is not False and values[high] - value >= swing:
            pivots.append(high)
            rising, low = False, k
        elif rising is not True and value - values[low] >= swing:
            pivots.append(low)
            rising, high = True, k
    return [*pivots, high if rising else low] if pivots else []


def _despiked(signal: np.ndarray, width: int) -> np.ndarray:
    """Running median over `width` samples, an odd number, of each column of (n, columns): removes single outliers."""
    padded = np.pad(signal, ((width // 2, width // 2), (0, 0)), mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, width, axis=0), axis=-1)


def _averaged(signal: np.ndarray, width: int) -> np.ndarray:
    """Running mean over `width` samples, an odd number, of each column of (n, columns)."""
    padded = np.pad(signal, ((width // 2, width // 2), (0, 0)), mode="edge")
    sums = np.cumsum(np.pad(padded, ((1, 0), (0, 0))), axis=0)
    return (sums[width:] - sums[:-width]) / width


def _noise(signal: np.ndarray) -> float:
    """Standard deviation of the noise on a signal (n,), from its steps, robust against real motion.

    Steps of nothing are left out, because a slow sensor is held over several frames; but a signal that changes in
    less than a fifth of its steps, as a switch does, has no noise.
    """
    steps = np.abs(np.diff(signal))
    steps = steps[steps > 0] if (steps > 0).mean() > 0.2 else np.zeros(1)
    return 1.4826 * float(np.median(steps)) / np.sqrt(2)


def _merged(events: Iterable[Event], rate_hz: float) -> Events:
    """In order; of events of one kind and side that are close together in different streams, the sharpest."""
    kept: list[Event] = []
    for event in sorted(events, key=lambda e: -e.sharpness):
        same = [k for k in kept if (k.kind, k.side) == (event.kind, event.side)]
        reach = [0 if k.stream == event.stream else MERGE_S * rate_hz for k in same]
        if all(abs(k.frame - event.frame) > most for k, most in zip(same, reach, strict=True)):
            kept.append(event)
    return tuple(sorted(kept, key=lambda e: (e.frame, e.kind, e.side)))
