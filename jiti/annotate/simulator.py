"""Proposals from a simulator's recordings: where each ITC was decided, and how, by the predicates that it traced."""

from collections.abc import Callable

import numpy as np

from jiti.annotate.segments import Segment
from jiti.annotate.window import proposed_window
from jiti.episodes.episode import Episode, loss, numbers
from jiti.errors import SourceError
from jiti.tasks.goal import parse_goal
from jiti.tasks.judge import MEASURES, PREDICATES, Trace, Verdict, judge
from jiti.tasks.task import ITC, Task

ANNOTATOR = "sim"
"""Name of the partition that these proposals are written to."""


def has_trace(episode: Episode) -> bool:
    """Whether a recording says what a simulator's predicates saw."""
    stream = episode.streams.get(PREDICATES)
    return stream is not None and stream.kind == "numeric" and stream.count > 0


def propose_from_simulator(episode: Episode, task: Task) -> list[Segment]:
    """A window of `DEFAULT_WINDOW_FRAMES` that ends where each ITC of a task was decided, with the trace's verdict.

    All have status `proposed` and source `sim`; the rationale says why, in words. ITCs that have no goal are left to
    people. Raises SourceError when the recording has no trace or lacks a part, CatalogueError when the trace lacks a
    predicate.
    """
    if (missing := loss(episode)) is not None:
        raise SourceError(f"{missing}. How it ended is not known, so nothing is judged.")
    trace, time_ns = read_trace(episode)
    return [_segment(episode, itc, judge(parse_goal(itc.goal), trace), time_ns) for itc in task.itcs if itc.goal]


def read_trace(episode: Episode) -> tuple[Trace, np.ndarray]:
    """The trace of a recording and the time of each of its steps (steps,) int64 in nanoseconds. Raises SourceError."""
    if not has_trace(episode):
        raise SourceError(
            f"{episode.episode_id} has no stream {PREDICATES!r}, in which a simulator says what it saw. `jiti record` "
            "makes such recordings; for others use `jiti autolabel --from signal`."
        )
    time_ns, holds = numbers(episode, PREDICATES)
    return Trace(_columns(episode, PREDICATES, holds, lambda v: v > 0.5), _measures(episode, len(time_ns))), time_ns


def _measures(episode: Episode, steps: int) -> dict[str, np.ndarray]:
    if MEASURES not in episode.streams:
        return {}
    _, values = numbers(episode, MEASURES)
    return (
        _columns(episode, MEASURES, values, lambda v: np.where(np.isnan(v), np.inf, v)) if len(values) == steps else {}
    )


def _columns(
    episode: Episode, stream: str, values: np.ndarray, read: Callable[[np.ndarray], np.ndarray]
) -> dict[str, np.ndarray]:
    return {name: read(values[:, column]) for column, name in enumerate(episode.streams[stream].names)}


def _segment(episode: Episode, itc: ITC, verdict: Verdict, time_ns: np.ndarray) -> Segment:
    clock = episode.clock
    # The frame that shows the step; without cameras, frames may have a rate of their own.
    decided = int(np.searchsorted(clock.frame_ns, time_ns[verdict.step], side="left"))
    decided = min(decided, clock.frame_count - 1)
    return proposed_window(
        episode,
        itc,
        decided,
        source="sim",
        reward=int(verdict.satisfied),
        confidence=1.0,
        rationale=f"{verdict.reason} Decided at frame {decided}.",
    )
