"""Where two annotators differ, and the rows that settle it.

What is settled goes to the partition of `adjudicated`. A row there names the segment that it settles as its parent,
which then no longer counts (see `curate.verdicts`): accepted, the row stands for it; rejected, there is no such
segment. Each segment of a difference gets a row; all other segments of the ITC go on counting.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from jiti.annotate.agreement import Agreement, Lane
from jiti.annotate.matching import Match
from jiti.annotate.segments import Segment, new_segment_id
from jiti.errors import LabelError

TOLERANCE_FRAMES = 5
"""Boundaries this close count as the same. Our choice: a sixth of a second at 30 Hz, a fifth of the paper's window."""

Kind = Literal["verdict", "boundary", "only_a", "only_b"]


@dataclass(frozen=True, slots=True)
class Difference:
    """One thing to settle."""

    kind: Kind
    a: Segment | None
    """None when only b marked something."""
    b: Segment | None
    iou: float
    settled: bool = False
    """Whether a row of `adjudicated` names one of the two."""

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Those of the two that are there."""
        return tuple(segment for segment in (self.a, self.b) if segment is not None)

    @property
    def start_frame(self) -> int:
        """Where to look."""
        return min(segment.start_frame for segment in self.segments)

    def to_json(self) -> dict[str, Any]:
        """Kind, place and both rows."""
        first = self.segments[0]
        return {
            "kind": self.kind,
            "episode_id": first.episode_id,
            "itc_id": first.itc_id,
            "start_frame": self.start_frame,
            "end_frame": max(segment.end_frame for segment in self.segments),
            "iou": self.iou,
            "settled": self.settled,
            "a": self.a.to_row() if self.a else None,
            "b": self.b.to_row() if self.b else None,
        }


def differences(
    agreement: Agreement, adjudicated: Iterable[Segment] = (), *, tolerance_frames: int = TOLERANCE_FRAMES
) -> list[Difference]:
    """What the annotators do not agree on, by episode, ITC and place; `adjudicated` are the rows that settle some."""
    settled = {row.parent_id for row in adjudicated}
    return [difference for lane in agreement.lanes for difference in _of_lane(lane, settled, tolerance_frames)]


def settle(
    agreement: Agreement,
    difference: Difference,
    choice: Segment | None,
    adjudicated: Sequence[Segment] = (),
) -> tuple[list[Segment], list[str]]:
    """Rows to put into and ids to remove from `adjudicated`'s partition of the episode, in one edit.

    `choice` is a's segment, b's, or a new one with what is right; None says that there is no such segment. Of two
    segments, the one that is not taken is rejected. `adjudicated` are the rows that the partition holds. Raises
    LabelError for a choice of another episode or ITC, or without a verdict.
    """
    parent = choice if choice in difference.segments else difference.segments[0]
    rows = [
        _row(one, one, status="rejected")
        for one in difference.segments
        if choice is None or one.segment_id != parent.segment_id
    ]
    if choice is not None:
        if (choice.episode_id, choice.itc_id) != (parent.episode_id, parent.itc_id):
            raise LabelError(
                f"a difference about {parent.itc_id!r} in {parent.episode_id!r} cannot be settled by a segment of "
                f"{choice.itc_id!r} in {choice.episode_id!r}"
            )
        if choice.reward is None:
            raise LabelError(f"segment {choice.segment_id} has no verdict; give one, pass or fail, to settle with it")
        rows.insert(0, _row(choice, parent, status="accepted"))
    about = {segment.segment_id for segment in difference.segments}
    before = [old.segment_id for old in adjudicated if old.parent_id in about]
    return rows, before


def _of_lane(lane: Lane, settled: set[str | None], tolerance_frames: int) -> list[Difference]:
    found = [
        Difference(kind, one.a, one.b, one.iou)
        for one in lane.matches
        if (kind := _kind(one, tolerance_frames)) is not None
    ]
    found += [Difference("only_a", segment, None, 0.0) for segment in lane.only_a]
    found += [Difference("only_b", None, segment, 0.0) for segment in lane.only_b]
    found.sort(key=lambda difference: difference.start_frame)
    return [replace(one, settled=any(s.segment_id in settled for s in one.segments)) for one in found]


def _kind(one: Match, tolerance_frames: int) -> Kind | None:
    """What is different about two matched segments; None when nothing is that matters."""
    if one.a.reward != one.b.reward or one.a.reward is None:
        return "verdict"
    return "boundary" if max(abs(one.start_error), abs(one.end_error)) > tolerance_frames else None


def _row(segment: Segment, parent: Segment, *, status: Literal["accepted", "rejected"]) -> Segment:
    return replace(
        segment,
        segment_id=new_segment_id(),
        parent_id=parent.segment_id,
        status=status,
        source="human",
        confidence=None,
        created_at=0,
        updated_at=0,
    )
