"""Agreement by hand: matching, overlaps, boundaries, kappa."""

import json
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from jiti.annotate.agreement import (
    Agreement,
    BoundaryError,
    cohens_kappa,
    compare,
    compare_labels,
    print_agreement,
)
from jiti.annotate.folder import segments_path
from jiti.annotate.matching import assignment, match, temporal_iou
from jiti.annotate.partition import Partition
from jiti.annotate.segments import Segment
from jiti.annotate.settling import differences, settle
from jiti.curate.rewards import frame_rewards
from jiti.errors import LabelError
from tests.builders.labels import RECORDING, segment, table

spans = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 12)), max_size=5)


def segments(shapes: list[tuple[int, int]]) -> list[Segment]:
    return [segment(start, start + more) for start, more in shapes]


def both(a: list[Segment], b: list[Segment], frames: int = 20) -> Agreement:
    return compare(table(*(("anna", row) for row in a), *(("bob", row) for row in b)), {"ep": frames}, "anna", "bob")


@pytest.mark.parametrize(
    ("a", "b", "iou"),
    [((0, 9), (0, 9), 1), ((0, 9), (5, 14), 5 / 15), ((0, 9), (9, 9), 0.1), ((0, 9), (10, 19), 0), ((3, 3), (3, 3), 1)],
)
def test_temporal_iou_counts_both_ends(a: tuple[int, int], b: tuple[int, int], iou: float) -> None:
    assert temporal_iou(segment(*a), segment(*b)) == temporal_iou(segment(*b), segment(*a)) == pytest.approx(iou)


@settings(deadline=None)
@given(st.integers(1, 5), st.integers(1, 5), st.data())
def test_assignment_is_the_best_of_all(rows: int, columns: int, data: st.DataObject) -> None:
    cells = st.lists(st.integers(0, 6), min_size=rows * columns, max_size=rows * columns)
    gain = np.array(data.draw(cells), float).reshape(rows, columns)
    found = assignment(gain)
    assert len({i for i, _ in found}) == len({j for _, j in found}) == len(found) == min(rows, columns)
    wide = gain if rows <= columns else gain.T
    best = max(sum(wide[i, j] for i, j in enumerate(p)) for p in permutations(range(wide.shape[1]), wide.shape[0]))
    assert sum(gain[i, j] for i, j in found) == pytest.approx(best)


def test_assignment_of_nothing() -> None:
    assert assignment(np.empty((0, 3))) == assignment(np.empty((3, 0))) == []


def test_matching_takes_the_best_total_not_the_best_pair() -> None:
    # Greedy would take 0-9 with 3-12 (7/13) and leave two segments alone.
    a, b = [segment(0, 9), segment(8, 17)], [segment(3, 12), segment(0, 2)]
    matches, only_a, only_b = match(a, b)
    assert {(one.a, one.b, one.iou) for one in matches} == {(a[0], b[1], 3 / 10), (a[1], b[0], 5 / 15)}
    assert only_a == only_b == []


@settings(deadline=None)
@given(spans, spans)
def test_every_segment_is_matched_once_or_left(a: list[tuple[int, int]], b: list[tuple[int, int]]) -> None:
    left, right = segments(a), segments(b)
    matches, only_a, only_b = match(left, right)
    assert sorted(s.segment_id for s in [one.a for one in matches] + only_a) == sorted(s.segment_id for s in left)
    assert sorted(s.segment_id for s in [one.b for one in matches] + only_b) == sorted(s.segment_id for s in right)
    assert all(one.iou == temporal_iou(one.a, one.b) > 0 for one in matches)
    swapped, _, _ = match(right, left)
    assert sum(one.iou for one in swapped) == pytest.approx(sum(one.iou for one in matches))
    if left and right:
        whole = np.array([[temporal_iou(x, y) for y in right] for x in left])
        assert sum(one.iou for one in matches) == pytest.approx(sum(whole[i, j] for i, j in assignment(whole)))


def test_cohens_kappa_by_hand() -> None:
    # Two raters, 50 items: 20 both yes, 15 both no, 5 and 10 apart: p_o = 0.7, p_e = 0.5 * 0.6 + 0.5 * 0.4 = 0.5.
    assert cohens_kappa(np.array([[20, 5], [10, 15]])) == pytest.approx(0.4)
    assert cohens_kappa(np.array([[7, 0], [0, 3]])) == 1
    assert cohens_kappa(np.array([[25, 25], [25, 25]])) == 0
    assert cohens_kappa(np.array([[0, 5], [5, 0]])) == pytest.approx(-1)
    assert cohens_kappa(np.array([[9, 0], [0, 0]])) is None
    assert cohens_kappa(np.zeros((3, 3), int)) is None


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=1, max_size=60))
def test_cohens_kappa_from_the_choices_themselves(choices: list[tuple[int, int]]) -> None:
    counts = np.zeros((3, 3), int)
    for a, b in choices:
        counts[a, b] += 1
    n = len(choices)
    observed = sum(a == b for a, b in choices) / n
    expected = sum(sum(a == k for a, _ in choices) * sum(b == k for _, b in choices) for k in range(3)) / n**2
    kappa = cohens_kappa(counts)
    if expected == 1:
        assert kappa is None
    else:
        assert kappa == pytest.approx((observed - expected) / (1 - expected))
        assert cohens_kappa(counts.T) == pytest.approx(kappa)


def test_two_annotators_by_hand() -> None:
    found = both(
        [segment(0, 9, 1), segment(12, 13, 0), segment(18, 19, 1)],
        [segment(2, 9, 1), segment(12, 15, 1)],
    )
    [hold, everything] = found.itcs
    assert (hold.itc_id, everything.itc_id) == ("t/hold", "all")
    assert (hold.episodes, hold.matched, hold.only_a, hold.only_b) == (1, 2, 1, 0)
    assert hold.mean_iou == pytest.approx((8 / 10 + 2 / 4) / 2)
    assert hold.mean_iou_with_unmatched == pytest.approx((8 / 10 + 2 / 4) / 3)
    assert hold.start_error == BoundaryError(1, 1, 1)  # 2 and 0
    assert hold.end_error == BoundaryError(1, 1, 1)  # 0 and 2
    # a: 1 in 0-9 and 18-19, 0 in 12-13; b: 1 in 2-9 and 12-15
    assert hold.frames == ((4, 0, 2), (0, 0, 2), (4, 0, 8))
    observed, expected = 12 / 20, (6 * 8 + 2 * 0 + 12 * 12) / 400
    assert hold.frame_kappa == pytest.approx((observed - expected) / (1 - expected))
    assert hold.verdict_agreement == 0.5
    assert hold.verdict_kappa == 0  # b says always 1
    assert everything.frames == hold.frames


def test_errors_are_signed_and_their_sizes_are_not() -> None:
    found = both([segment(10, 19), segment(30, 49)], [segment(7, 20), segment(35, 40)], 60)
    assert found.itcs[0].start_error == BoundaryError(1, 4, 4)  # -3 and +5
    assert found.itcs[0].end_error == BoundaryError(-4, 5, 5)  # +1 and -9


def test_full_agreement() -> None:
    rows = [segment(0, 9, 1), segment(12, 15, 0)]
    [hold, _] = both(rows, [segment(0, 9, 1), segment(12, 15, 0)]).itcs
    assert (hold.mean_iou, hold.frame_kappa, hold.verdict_kappa, hold.verdict_agreement) == (1, 1, 1, 1)
    assert hold.start_error == BoundaryError(0, 0, 0)


def test_itcs_are_compared_each_by_itself() -> None:
    found = both([segment(0, 9, itc_id="t/a")], [segment(0, 9, itc_id="t/b")])
    assert [(itc.itc_id, itc.matched, itc.only_a, itc.only_b) for itc in found.itcs] == [
        ("t/a", 0, 1, 0),
        ("t/b", 0, 0, 1),
        ("all", 0, 1, 1),
    ]
    assert found.itcs[0].mean_iou is None
    assert found.itcs[0].mean_iou_with_unmatched == 0
    assert found.itcs[0].start_error is None
    assert found.itcs[0].verdict_kappa is None


def test_only_what_counts_is_compared_and_rejecting_is_work_as_well() -> None:
    a = [segment(0, 9, 1), segment(12, 15, 0, status="rejected")]
    b = [segment(0, 9, status="rejected")]
    found = both(a, b)
    assert found.episodes == ("ep",)
    assert (found.itcs[0].only_a, found.itcs[0].only_b) == (1, 0)


def test_episodes_of_one_annotator_are_apart_from_disagreement() -> None:
    rows = table(
        ("anna", segment(0, 9, episode_id="e1")),
        ("anna", segment(0, 9, episode_id="e2")),
        ("bob", segment(0, 9, episode_id="e2")),
        ("bob", segment(0, 9, episode_id="e3")),
        ("cleo", segment(0, 9, episode_id="e1")),
    )
    found = compare(rows, {"e1": 10, "e2": 10, "e3": 10}, "anna", "bob")
    assert (found.episodes, found.episodes_only_a, found.episodes_only_b) == (("e2",), ("e1",), ("e3",))
    assert (found.itcs[-1].matched, found.itcs[-1].only_a, found.itcs[-1].only_b) == (1, 0, 0)
    apart = compare(rows, {}, "bob", "cleo")
    assert [itc.itc_id for itc in apart.itcs] == ["all"]
    assert apart.itcs[0].mean_iou_with_unmatched is None


def test_a_machine_is_compared_by_its_proposals() -> None:
    rows = table(
        ("anna", segment(0, 9, 1)),
        ("vlm", segment(0, 9, 0, status="proposed", source="vlm")),
        ("bob", segment(0, 9, 0, status="proposed")),
    )
    found = compare(rows, {"ep": 20}, "anna", "vlm")
    assert (found.itcs[0].matched, found.itcs[0].verdict_agreement) == (1, 0)
    assert compare(rows, {"ep": 20}, "anna", "bob").episodes == ()


def test_names_that_do_not_fit_are_answered_with_those_there_are() -> None:
    rows = table(("anna", segment()), ("bob", segment()))
    with pytest.raises(LabelError, match="'cleo' has no labels here; there are labels by: anna, bob"):
        compare(rows, {}, "anna", "cleo")
    with pytest.raises(LabelError, match="there are labels by: no one"):
        compare(table(), {}, "anna", "bob")
    with pytest.raises(LabelError, match="cannot be compared with themselves"):
        compare(rows, {}, "anna", "anna")


def test_the_result_is_json_and_a_table() -> None:
    found = both([segment(0, 9, 1)], [segment(2, 9, 0)])
    assert json.loads(json.dumps(found.to_json()))["itcs"][0]["mean_iou"] == 0.8
    console = Console(width=120, record=True, file=None, force_terminal=False)
    with console.capture() as capture:
        console.print(found.to_table())
    text = capture.get()
    assert "t/hold" in text
    assert "0.80" in text
    assert "2.0 (+2.0)" in text


def test_a_labels_folder_is_compared_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for annotator, end in (("anna", 9), ("bob", 19)):
        Partition(tmp_path, annotator, "ep", RECORDING).apply("mark", [segment(0, end)], based_on=0)
    found = compare_labels(tmp_path, "anna", "bob")
    assert found.itcs[0].frames == ((280, 0, 10), (0, 0, 0), (0, 0, 10))
    print_agreement(found, as_json=True)
    assert json.loads(capsys.readouterr().out)["itcs"][0]["end_error"] == {
        "mean": 10,
        "mean_absolute": 10,
        "median_absolute": 10,
    }
    print_agreement(found)
    assert "anna and bob over 1 episodes" in capsys.readouterr().out
    segments_path(tmp_path, "bob", "ep").write_bytes(b"junk")
    with pytest.raises(LabelError, match=r"ep\.parquet cannot be read"):
        compare_labels(tmp_path, "anna", "bob")


def test_differences_by_kind_and_place() -> None:
    same, shifted, turned, alone = segment(0, 9, 1), segment(20, 29, 1), segment(40, 49, 1), segment(60, 69, 1)
    b = [segment(3, 9, 1), segment(27, 36, 1), segment(40, 49, 0), segment(80, 89, None), segment(90, 95, None)]
    found = both([same, shifted, turned, alone, segment(90, 95, None)], b, 100)
    kinds = [(d.kind, d.start_frame, d.settled) for d in differences(found)]
    assert kinds == [
        ("boundary", 20, False),
        ("verdict", 40, False),
        ("only_a", 60, False),
        ("only_b", 80, False),
        ("verdict", 90, False),  # both left it open
    ]
    assert next(d.kind for d in differences(found, tolerance_frames=0)) == "boundary"
    assert len(differences(found, tolerance_frames=0)) == 6
    shown = differences(found)[1].to_json()
    assert (shown["episode_id"], shown["itc_id"], shown["start_frame"], shown["end_frame"]) == ("ep", "t/hold", 40, 49)
    assert (shown["a"]["reward"], shown["b"]["reward"]) == (1, 0)


def test_settling_every_difference_gives_the_rewards_that_were_chosen() -> None:
    a = [segment(0, 4, 1), segment(6, 9, 1), segment(12, 14, 1)]
    b = [segment(0, 4, 1), segment(6, 9, 0), segment(16, 18, 1)]
    found = both(a, b)
    settled: list[Segment] = []

    def rewards() -> list[int]:
        rows = [*(("anna", s) for s in a), *(("bob", s) for s in b), *(("adjudicated", s) for s in settled)]
        return frame_rewards(table(*rows), {"ep": 20}).reward.astype(int).tolist()

    def decide(place: int, choice: Segment | None) -> None:
        put, remove = settle(found, differences(found, settled)[place], choice, settled)
        settled[:] = [row for row in settled if row.segment_id not in remove] + put

    assert [d.kind for d in differences(found)] == ["verdict", "only_a", "only_b"]
    decide(0, a[1])
    assert rewards() == [1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 0, 1, 1, 1, 0]  # the rest goes on counting
    assert [d.settled for d in differences(found, settled)] == [True, False, False]
    decide(1, None)
    decide(2, segment(16, 17, 1))
    assert all(d.settled for d in differences(found, settled))
    assert rewards() == [1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0]
    decide(0, b[1])  # someone thinks again
    assert rewards() == [1, 1, 1, 1, 1] + [0] * 11 + [1, 1, 0, 0]
    assert len(settled) == 4
    assert [row.status for row in settled].count("rejected") == 2
    assert all(row.source == "human" and row.parent_id for row in settled)


def test_a_choice_that_does_not_fit_is_refused() -> None:
    found = both([segment(0, 4, 1)], [segment(0, 4, 0)])
    [difference] = differences(found)
    with pytest.raises(LabelError, match="about 't/hold' in 'ep' cannot be settled by a segment of 't/other' in 'ep'"):
        settle(found, difference, segment(0, 4, 1, itc_id="t/other"))
    with pytest.raises(LabelError, match="has no verdict; give one, pass or fail, to settle with it"):
        settle(found, difference, segment(0, 4, None))
