"""Proposals: segments that a machine suggests, the order in which to ask a person, and what the person decides.

A proposal's row is never changed by a decision. A decision is a row in the person's own partition that names the
proposal as its parent; undoing the decision brings the proposal back.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from jiti.annotate.folder import annotator_dirs, segments_path, write_segments_file
from jiti.annotate.names import MACHINES, file_stem
from jiti.annotate.segment_file import DamagedFile, FileInfo, Recording, decode, encode, to_segments
from jiti.annotate.segments import Segment, new_segment_id
from jiti.errors import LabelError

NO_CONFIDENCE = 0.5
"""Confidence of a verdict that comes without one. Our choice: of a binary verdict, this says nothing."""

SAME_EVENT_IOU = 0.5
"""From which overlap on a new proposal is about what a person already decided. Our choice, usual for detections."""


def expected_change(proposal: Segment) -> float:
    """Frames whose label a review is expected to change; all of them where the machine left the verdict open."""
    if proposal.reward is None:
        return float(proposal.frame_count)
    confidence = NO_CONFIDENCE if proposal.confidence is None else proposal.confidence
    return (1 - confidence) * proposal.frame_count


def queue(segments: pa.Table, annotator: str) -> list[Segment]:
    """Proposals in a table of `read_segments` that an annotator has not decided, the most to be gained first."""
    names = segments["annotator"].to_numpy()
    proposed = segments["status"].to_numpy() == "proposed"
    own = segments.filter(pa.array(names == annotator))
    return pending(to_segments(segments.filter(pa.array(proposed))), own["parent_id"].to_pylist())


def pending(proposals: Iterable[Segment], decided: Iterable[str | None]) -> list[Segment]:
    """Proposals whose id is not among the decided ones, the most to be gained first, then by place."""
    known = set(decided)
    open_ones = [p for p in proposals if p.status == "proposed" and p.segment_id not in known]
    return sorted(open_ones, key=lambda p: (-expected_change(p), p.episode_id, p.start_frame, p.segment_id))


def accept(proposal: Segment) -> Segment:
    """The row of a person who takes a proposal as it is. Raises LabelError when its verdict is open."""
    if proposal.reward is None:
        raise LabelError(
            f"proposal {proposal.segment_id} (frames {proposal.start_frame} to {proposal.end_frame}) has no verdict; "
            "give one, pass or fail, instead of accepting it"
        )
    return _decision(proposal, status="accepted")


def edit(proposal: Segment, **changes: Any) -> Segment:
    """The row of a person who takes a proposal with changes: to frames and times, verdict, ITC or note."""
    return _decision(proposal, status="accepted", source="human", confidence=None, **changes)


def reject(proposal: Segment) -> Segment:
    """The row of a person who says that a proposal is wrong."""
    return _decision(proposal, status="rejected")


def write_proposals(
    labels_dir: Path, annotator: str, episode_id: str, segments: Sequence[Segment], recording: Recording
) -> int:
    """Replace a machine's proposals for one episode, durably; gives how many are there now.

    What people decided stays: their proposals are kept, and new ones about the same event are left out. A proposal that
    was there already keeps its id. Raises LabelError for rows that are no proposals of this episode, SaveFailed.
    """
    if annotator not in MACHINES:
        raise LabelError(f"{annotator!r} cannot propose; the machines' partitions are {', '.join(MACHINES)}")
    for segment in segments:
        if segment.episode_id != episode_id or segment.status != "proposed":
            raise LabelError(
                f"segment {segment.segment_id} of {segment.episode_id!r} with status {segment.status!r} is no proposal "
                f"for {episode_id!r}"
            )
    path = segments_path(labels_dir, annotator, episode_id)
    old, info = _read(path)
    decided = _decided(labels_dir, episode_id)
    kept = [segment for segment in old if segment.segment_id in decided]
    known = {_about(segment): segment for segment in old if segment.segment_id not in decided}
    rows = list(kept)
    for segment in segments:
        if not any(_same_event(segment, other) for other in kept):
            before = known.pop(_about(segment), None)
            if before is not None:
                segment = replace(segment, segment_id=before.segment_id, created_at=before.created_at)
                if segment == replace(before, updated_at=segment.updated_at):
                    segment = before
            rows.append(segment)
    rows.sort(key=lambda segment: (segment.start_frame, segment.end_frame, segment.segment_id))
    recordings = {episode_id: recording}
    if rows != old or info.version is None or dict(info.recordings) != recordings:
        data = encode(rows, FileInfo((info.version or 0) + 1, annotator, recordings))
        write_segments_file(path, memoryview(data), locked=False)
    return len(rows)


def _decision(proposal: Segment, **changes: Any) -> Segment:
    return replace(
        proposal,
        **{
            "segment_id": new_segment_id(),
            "parent_id": proposal.segment_id,
            "created_at": 0,
            "updated_at": 0,
            **changes,
        },
    )


def _read(path: Path) -> tuple[list[Segment], FileInfo]:
    try:
        table, info = decode(path)
        return to_segments(table), info
    except (FileNotFoundError, DamagedFile):
        return [], FileInfo()  # a machine can propose again


def _decided(labels_dir: Path, episode_id: str) -> set[str]:
    """Ids of proposals that someone decided in this episode."""
    name = f"{file_stem(episode_id)}.parquet"
    found: set[str] = set()
    for annotator, folder in annotator_dirs(labels_dir):
        if annotator not in MACHINES and (folder / name).exists():
            table, _ = decode(folder / name)
            found.update(parent_id for parent_id in table["parent_id"].to_pylist() if parent_id)
    return found


def _about(segment: Segment) -> tuple[str, int, int, int | None]:
    return segment.itc_id, segment.start_frame, segment.end_frame, segment.reward


def _same_event(a: Segment, b: Segment) -> bool:
    shared = min(a.end_frame, b.end_frame) - max(a.start_frame, b.start_frame) + 1
    return a.itc_id == b.itc_id and shared >= SAME_EVENT_IOU * (a.frame_count + b.frame_count - shared)
