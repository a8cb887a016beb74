"""Which frames of an episode a model is shown."""

from collections.abc import Iterable

import numpy as np

from jiti.annotate.events import Event
from jiti.episodes.clock import Clock

OVERVIEW_FRAMES = 24
"""Frames of a whole episode. Our choice: two sheets of 12 a camera, some 1,600 tokens of a Qwen3-VL."""
SEGMENT_FRAMES = 10
"""Frames of a segment, beside the episode's first and last. Our choice: one sheet with those."""
AROUND_S = 0.25
"""Before and after an event, in seconds. Our choice: a gripper closes in 0.1 to 0.5 s."""
MARGIN_S = 0.3
"""Shown before and after a segment, in seconds."""


def overview_frames(clock: Clock, events: Iterable[Event], most: int = OVERVIEW_FRAMES) -> list[int]:
    """The first and the last frame, those at, before and after the sharpest events, and the rest where gaps are widest.

    Increasing; all frames of an episode that has no more than `most`.
    """
    count = clock.frame_count
    if count <= most:
        return list(range(count))
    around = max(1, round(AROUND_S * clock.rate_hz))
    taken = {0, count - 1}
    for event in sorted(events, key=lambda e: -e.sharpness):
        three = {min(max(event.frame + step, 0), count - 1) for step in (-around, 0, around)}
        # Half of the frames are for events: what happens between them is to be seen as well.
        if len(taken | three) > most // 2:
            break
        taken |= three
    return _filled(taken, most)


def segment_frames(clock: Clock, start: int, end: int, most: int = SEGMENT_FRAMES) -> list[int]:
    """Frames of a segment (both inclusive) and a little around it, evenly, and the episode's first and last."""
    margin = round(MARGIN_S * clock.rate_hz)
    last = clock.frame_count - 1
    low, high = max(0, start - margin), min(last, end + margin)
    inner = np.linspace(low, high, min(most, high - low + 1)).round().astype(int)
    return sorted({0, last, *inner.tolist()})


def _filled(taken: set[int], most: int) -> list[int]:
    """Add the middle of the widest gap until there are `most`."""
    frames = sorted(taken)
    while len(frames) < most:
        gaps = np.diff(frames)
        widest = int(gaps.argmax())
        if gaps[widest] < 2:
            break
        frames.insert(widest + 1, frames[widest] + int(gaps[widest]) // 2)
    return frames
