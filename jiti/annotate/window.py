"""A proposal's segment: the paper's 25 frames, ending where something was decided."""

import time
from typing import Any

import numpy as np

from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES, Segment, Source, new_segment_id
from jiti.episodes.clock import Clock
from jiti.episodes.episode import Episode
from jiti.tasks.task import ITC


def proposed_window(episode: Episode, itc: ITC, end: int, *, source: Source, **fields: Any) -> Segment:
    """`DEFAULT_WINDOW_FRAMES` frames, the last of them `end`, moved into the episode where they reach out of it."""
    end = min(max(end, DEFAULT_WINDOW_FRAMES - 1), episode.clock.frame_count - 1)
    start = max(0, end - DEFAULT_WINDOW_FRAMES + 1)
    return proposed_segment(episode, itc, start, end, source=source, **fields)


def proposed_segment(episode: Episode, itc: ITC, start: int, end: int, *, source: Source, **fields: Any) -> Segment:
    """A proposal for frames `start` to `end`, both inclusive."""
    now = time.time_ns()
    return Segment(
        segment_id=new_segment_id(),
        episode_id=episode.episode_id,
        itc_id=itc.itc_id,
        criterion=itc.criterion.value,
        start_frame=start,
        end_frame=end,
        start_ns=int(episode.clock.frame_ns[start]),
        end_ns=int(episode.clock.frame_ns[end]),
        status="proposed",
        source=source,
        created_at=now,
        updated_at=now,
        **fields,
    )


SHOWN_S = 0.005001
"""Times are shown with two digits: this far from one, a frame may be the one that was meant."""


def frames_between(clock: Clock, start_s: float, end_s: float) -> tuple[int, int]:
    """First and last frame, both inclusive, of a time in seconds since the first frame; one frame at least.

    Times shorter than `DEFAULT_WINDOW_FRAMES` become that many frames around their middle, as far as there are any.
    """
    since_s = (clock.frame_ns - clock.frame_ns[0]) / 1e9
    last = clock.frame_count - 1
    start = int(np.clip(np.searchsorted(since_s, start_s - SHOWN_S), 0, last))
    end = int(np.clip(np.searchsorted(since_s, end_s + SHOWN_S, side="right") - 1, start, last))
    if (missing := DEFAULT_WINDOW_FRAMES - (end - start + 1)) > 0:
        start = max(0, start - missing // 2)
        end = min(last, start + DEFAULT_WINDOW_FRAMES - 1)
        start = max(0, end - DEFAULT_WINDOW_FRAMES + 1)
    return start, end
