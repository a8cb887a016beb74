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
    "accepted segments with a verdict, without those that a row of `adjudicated` names as its parent; of one annotator "
    "and ITC the lower verdict; per ITC the rows of `adjudicated` on the frames that they cover, else the majority of "
    "annotators, ties 0; per frame the minimum over ITCs"
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
    """Annotators who say satisfied; 1 or 0 where it is settled."""
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

    last = np.where(known, counts[np.maximum(episode, 0)], 0) - 1 if len(counts) else np.full(len(lane), -1)
    end = np.minimum(end, last)
    counted = known & (status == "accepted") & (reward >= 0) & (start <= end)
    counted &= ~replaced(segments)
    lane, annotator, reward = lane[counted], annotator[counted], reward[counted]
    first, stop = lane * length + start[counted], lane * length + end[counted] + 1

    edges = np.unique(np.concatenate([first, stop]))
    passes, fails = np.zeros(len(edges), np.int32), np.zeros(len(edges), np.int32)
    settled = np.zeros(len(edges), bool)
    for one in sorted(np.unique(annotator).tolist(), key=lambda one: one == adjudicator):
        failed = _covered(first, stop, (annotator == one) & (reward == 0), edges)
        passed = _covered(first, stop, (annotator == one) & (reward == 1), edges)
        if one == adjudicator:  # the last: the others say nothing more where it does
            settled = passed | failed
            passes[settled], fails[settled] = 0, 0
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
        settled[there],
    )


def replaced(segments: pa.Table) -> np.ndarray:
    """(rows,) bool: segments of others that `adjudicated` has settled, so that its rows stand for them."""
    if not len(segments):
        return np.zeros(0, bool)
    adjudicated = segments["annotator"].to_numpy() == ADJUDICATED
    settles = adjudicated & np.isin(segments["status"].to_numpy(), ("accepted", "rejected"))
    parents = {name for name in segments["parent_id"].filter(pa.array(settles)).to_pylist() if name is not None}
    if not parents:
        return np.zeros(len(segments), bool)
    return ~adjudicated & np.isin(segments["segment_id"].to_numpy(), [*parents])


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
