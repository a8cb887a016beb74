"""What annotators say about each ITC, frame by frame, and what holds where they differ.

Nothing here loops over frames: verdicts change only where segments begin or end, so they are worked out for the
spans in between. A person's overlapping segments of one ITC count as violated where one of them does.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from jiti.annotate.names import ADJUDICATED
from jiti.curate.rows import codes

RULE = (
    "accepted segments with a verdict; of one annotator and ITC the lower verdict; per ITC the rows of `adjudicated` "
    "where there are any for the episode, else the majority of annotators, ties 0; per frame the minimum over ITCs"
)
"""How verdicts become rewards, in words, for the metadata of what is derived."""


@dataclass(frozen=True, slots=True)
class Spans:
    """Runs of frames in which everyone's verdict on one ITC of one episode stays the same; arrays of one length."""

    episode_ids: list[str]
    itc_ids: list[str]
    episode: np.ndarray
    """Place in `episode_ids`."""
    itc: np.ndarray
    """Place in `itc_ids`."""
    start: np.ndarray
    """First frame."""
    end: np.ndarray
    """Last frame, inclusive."""
    passes: np.ndarray
    """Annotators who say satisfied; 1 or 0 where the difference is settled."""
    fails: np.ndarray
    """Annotators who say violated."""
    settled: np.ndarray
    """Whether the verdict is that of `adjudicated`."""

    @property
    def verdict(self) -> np.ndarray:
        """1 where a majority says satisfied, else 0."""
        return (self.passes > self.fails).astype(np.int8)


def spans(segments: pa.Table, frame_counts: Mapping[str, int]) -> Spans:
    """Spans with at least one verdict, by episode, ITC and start, from a table of `read_segments`.

    `frame_counts` gives the episodes and their order. Segments of other episodes are left out, and so is what
    lies outside an episode.
    """
    episode_ids = list(frame_counts)
    counts = np.fromiter(frame_counts.values(), np.int64, len(episode_ids))
    segments = segments.combine_chunks()
    episode = _places(segments["episode_id"], episode_ids)
    itc_ids, itc = codes(segments["itc_id"])
    annotators, annotator = codes(segments["annotator"])
    status = segments["status"].to_numpy()
    reward = segments["reward"].fill_null(-1).to_numpy()
    start, end = segments["start_frame"].to_numpy(), segments["end_frame"].to_numpy()

    # A lane is the frames of one ITC in one episode. All lanes lie one behind the other on one line of places.
    known = episode >= 0
    lanes, lane = np.unique(episode * max(1, len(itc_ids)) + itc, return_inverse=True)
    length = int(counts.max(initial=0)) + 1
    adjudicator = annotators.index(ADJUDICATED) if ADJUDICATED in annotators else -1
    settled = np.zeros(len(lanes), bool)
    settled[lane[known & (annotator == adjudicator) & np.isin(status, ("accepted", "rejected"))]] = True

    last = np.where(known, counts[np.maximum(episode, 0)], 0) - 1 if len(counts) else np.full(len(lane), -1)
    end = np.minimum(end, last)
    counted = known & (status == "accepted") & (reward >= 0) & (start <= end)
    counted &= ~settled[lane] | (annotator == adjudicator)
    lane, annotator, reward = lane[counted], annotator[counted], reward[counted]
    first, stop = lane * length + start[counted], lane * length + end[counted] + 1

    edges = np.unique(np.concatenate([first, stop]))
    passes, fails = np.zeros(len(edges), np.int32), np.zeros(len(edges), np.int32)
    for one in np.unique(annotator):
        failed = _covered(first, stop, (annotator == one) & (reward == 0), edges)
        passed = _covered(first, stop, (annotator == one) & (reward == 1), edges)
        fails += failed
        passes += passed & ~failed
    there = np.flatnonzero(passes + fails)
    lane_of = edges[there] // length
    return Spans(
        episode_ids,
        itc_ids,
        lanes[lane_of] // max(1, len(itc_ids)),
        lanes[lane_of] % max(1, len(itc_ids)),
        edges[there] % length,
        edges[np.minimum(there + 1, len(edges) - 1)] - lane_of * length - 1,
        passes[there],
        fails[there],
        settled[lane_of],
    )


def _covered(first: np.ndarray, stop: np.ndarray, which: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Whether any of the chosen segments covers the span that begins at each edge."""
    begun = np.bincount(np.searchsorted(edges, first[which]), minlength=len(edges))
    ended = np.bincount(np.searchsorted(edges, stop[which]), minlength=len(edges))
    return np.cumsum(begun - ended) > 0


def _places(column: pa.ChunkedArray, known: list[str]) -> np.ndarray:
    """The place of each row's text in a list, -1 where it is not there."""
    names, code = codes(column)
    place = {name: number for number, name in enumerate(known)}
    return np.array([place.get(name, -1) for name in names], np.int64)[code]
