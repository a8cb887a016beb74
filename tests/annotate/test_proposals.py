"""The order of the queue, the rows of decisions, and proposals that are written again."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.folder import labels_version, segments_path
from jiti.annotate.labels import read_segments
from jiti.annotate.partition import Partition
from jiti.annotate.proposals import accept, edit, expected_change, pending, queue, reject, write_proposals
from jiti.annotate.segment_file import decode, to_segments
from jiti.annotate.segments import Segment
from jiti.errors import LabelError
from tests.builders.labels import RECORDING, segment


def proposal(start: int = 10, end: int = 34, reward: int | None = 1, **fields: object) -> Segment:
    return segment(start, end, reward, **{"status": "proposed", "source": "signal", **fields})


def written(folder: Path, annotator: str = "signal") -> list[Segment]:
    return to_segments(decode(segments_path(folder, annotator, "ep"))[0])


def test_expected_change_by_hand() -> None:
    assert expected_change(proposal(0, 24, 1, confidence=0.9)) == pytest.approx(2.5)
    assert expected_change(proposal(0, 24, 0, confidence=1.0)) == 0
    assert expected_change(proposal(0, 24, 1)) == 12.5
    assert expected_change(proposal(0, 24, None, confidence=0.99)) == 25
    assert expected_change(proposal(7, 7, None)) == 1


def test_the_queue_asks_first_what_changes_most() -> None:
    sure = proposal(0, 99, 1, confidence=0.95)  # 5 frames
    short = proposal(5, 14, 1, confidence=0.2)  # 8
    silent = proposal(50, 69, 0)  # 10
    undecided = proposal(80, 90, None)  # 11
    later = proposal(81, 91, None)  # 11, further on
    rows = [sure, short, later, silent, undecided, segment(0, 99)]
    assert pending(rows, []) == [undecided, later, silent, short, sure]
    assert pending(rows, [undecided.segment_id, silent.segment_id, None]) == [later, short, sure]


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50), st.none() | st.integers(0, 1), st.floats(0, 1))))
def test_the_queue_is_ordered_and_whole(shapes: list[tuple[int, int, int | None, float]]) -> None:
    rows = [proposal(start, start + more, reward, confidence=sure) for start, more, reward, sure in shapes]
    ordered = pending(rows, [])
    changes = [expected_change(row) for row in ordered]
    assert changes == sorted(changes, reverse=True)
    assert sorted(row.segment_id for row in ordered) == sorted(row.segment_id for row in rows)


def test_decisions_name_their_proposal_and_leave_it_alone() -> None:
    row = proposal(10, 34, 0, confidence=0.7, rationale="gripper opens early", created_at=5, updated_at=6)
    taken, changed, refused = accept(row), edit(row, start_frame=12, start_ns=7, rationale="later"), reject(row)
    for decision in (taken, changed, refused):
        assert decision.parent_id == row.segment_id
        assert decision.segment_id != row.segment_id
        assert (decision.itc_id, decision.end_frame, decision.reward) == (row.itc_id, 34, 0)
    assert (taken.status, taken.source, taken.confidence, taken.rationale) == (
        "accepted",
        "signal",
        0.7,
        "gripper opens early",
    )
    assert (changed.status, changed.source, changed.confidence, changed.start_frame) == ("accepted", "human", None, 12)
    assert (refused.status, refused.source) == ("rejected", "signal")
    with pytest.raises(LabelError, match=r"\(frames 10 to 34\) has no verdict; give one, pass or fail"):
        accept(proposal(10, 34, None))
    assert edit(proposal(10, 34, None), reward=1).reward == 1


def test_each_annotator_has_a_queue_and_undo_brings_a_proposal_back(tmp_path: Path) -> None:
    first, second = proposal(0, 24), proposal(50, 94)
    assert write_proposals(tmp_path, "signal", "ep", [first, second], RECORDING) == 2
    anna = Partition(tmp_path, "anna", "ep", RECORDING)
    anna.apply("accept", [accept(second)], based_on=0)
    assert [p.segment_id for p in queue(read_segments(tmp_path), "anna")] == [first.segment_id]
    assert [p.segment_id for p in queue(read_segments(tmp_path), "bob")] == [second.segment_id, first.segment_id]
    anna.apply("reject", [reject(first)], based_on=1)
    assert queue(read_segments(tmp_path), "anna") == []
    anna.undo(based_on=2)
    assert [p.segment_id for p in queue(read_segments(tmp_path), "anna")] == [first.segment_id]


def test_proposing_again_keeps_ids_and_what_people_decided(tmp_path: Path) -> None:
    stays, decided, goes = proposal(0, 24), proposal(50, 74), proposal(100, 124)
    write_proposals(tmp_path, "vlm", "ep", [stays, decided, goes], RECORDING)
    anna = Partition(tmp_path, "anna", "ep", RECORDING)
    anna.apply("reject", [reject(decided)], based_on=0)
    before = labels_version(tmp_path)
    assert (
        write_proposals(tmp_path, "vlm", "ep", [proposal(0, 24), proposal(50, 74), proposal(100, 124)], RECORDING) == 3
    )
    assert labels_version(tmp_path) == before  # nothing new, nothing written
    assert written(tmp_path, "vlm") == [stays, decided, goes]

    moved, other = proposal(52, 76, 1), proposal(52, 76, itc_id="t/place")
    surer = proposal(0, 24, confidence=0.9)
    assert write_proposals(tmp_path, "vlm", "ep", [surer, moved, other], RECORDING) == 3
    assert [(row.segment_id, row.confidence) for row in written(tmp_path, "vlm")] == [
        (stays.segment_id, 0.9),
        (decided.segment_id, None),
        (other.segment_id, None),
    ]
    assert decode(segments_path(tmp_path, "vlm", "ep"))[1].version == 2
    assert [p.segment_id for p in queue(read_segments(tmp_path), "anna")] == [other.segment_id, stays.segment_id]
    assert anna.segments[0].parent_id == decided.segment_id

    assert write_proposals(tmp_path, "vlm", "ep", [], RECORDING) == 1
    assert [row.segment_id for row in written(tmp_path, "vlm")] == [decided.segment_id]


def test_a_damaged_file_of_proposals_is_replaced(tmp_path: Path) -> None:
    write_proposals(tmp_path, "sim", "ep", [proposal()], RECORDING)
    segments_path(tmp_path, "sim", "ep").write_bytes(b"junk")
    assert write_proposals(tmp_path, "sim", "ep", [proposal(1, 2)], RECORDING) == 1
    assert [row.start_frame for row in written(tmp_path, "sim")] == [1]


def test_only_machines_propose_and_only_proposals(tmp_path: Path) -> None:
    with pytest.raises(LabelError, match="'anna' cannot propose; the machines' partitions are signal, vlm, sim"):
        write_proposals(tmp_path, "anna", "ep", [], RECORDING)
    with pytest.raises(LabelError, match="with status 'accepted' is no proposal for 'ep'"):
        write_proposals(tmp_path, "vlm", "ep", [segment()], RECORDING)
    with pytest.raises(LabelError, match="of 'other' with status 'proposed' is no proposal for 'ep'"):
        write_proposals(tmp_path, "vlm", "ep", [proposal(episode_id="other")], RECORDING)
    assert not tmp_path.joinpath("segments").exists()
