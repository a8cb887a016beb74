"""A proposal's segment: the paper's 25 frames, ending where something was decided."""

import time
from typing import Any

from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES, Segment, Source, new_segment_id
from jiti.episodes.episode import Episode
from jiti.tasks.task import ITC


def proposed_window(episode: Episode, itc: ITC, end: int, *, source: Source, **fields: Any) -> Segment:
    """`DEFAULT_WINDOW_FRAMES` frames, the last of them `end`, moved into the episode where they reach out of it."""
    clock, now = episode.clock, time.time_ns()
    end = min(max(end, DEFAULT_WINDOW_FRAMES - 1), clock.frame_count - 1)
    start = max(0, end - DEFAULT_WINDOW_FRAMES + 1)
    return Segment(
        segment_id=new_segment_id(),
        episode_id=episode.episode_id,
        itc_id=itc.itc_id,
        criterion=itc.criterion.value,
        start_frame=start,
        end_frame=end,
        start_ns=int(clock.frame_ns[start]),
        end_ns=int(clock.frame_ns[end]),
        status="proposed",
        source=source,
        created_at=now,
        updated_at=now,
        **fields,
    )
