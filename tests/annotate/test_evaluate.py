"""Scores of proposals worked out by hand, the paper's figures beside them, and the reliability plot."""

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image
from rich.console import Console

from jiti.annotate.evaluate import BINS, Evaluation, Scores, calibration_error, compare_lanes, evaluate, save
from jiti.annotate.folder import segments_path
from jiti.annotate.matching import temporal_iou
from jiti.annotate.partition import Partition
from jiti.annotate.proposals import accept, reject, write_proposals
from jiti.annotate.reliability import plot_png
from jiti.annotate.segments import Segment
from jiti.errors import LabelError
from jiti.tasks.task import Criterion
from tests.builders.labels import RECORDING, segment

PANEL_PX = 384
"""3.2 inches at 120 dots."""

# Frames from one to another, and a verdict.
SPANS = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 15), st.sampled_from([None, 0, 1])), max_size=6)
# Of segments that do not overlap, as one annotator marks: frames before it, frames that it has, a verdict.
GAPS = st.lists(st.tuples(st.integers(0, 8), st.integers(1, 15), st.sampled_from([None, 0, 1])), max_size=6)
CONFIDENCE = st.floats(0, 1)


def lanes(segments: Sequence[Segment]) -> dict[tuple[str, str], list[Segment]]:
    found: dict[tuple[str, str], list[Segment]] = {}
    for one in segments:
        found.setdefault((one.episode_id, one.itc_id), []).append(one)
    return found


def compared(reference: Sequence[Segment], proposed: Sequence[Segment]) -> Evaluation:
    return compare_lanes(lanes(reference), lanes(proposed), "vlm", "ada")


def apart(gaps: Sequence[tuple[int, int, int | None]]) -> list[Segment]:
    found, at = [], 0
    for before, frames, reward in gaps:
        found.append(segment(at + before, at + before + frames - 1, reward, confidence=0.5))
        at += before + frames
    return found


def score(evaluation: Evaluation, name: str = "all") -> Scores:
    (found,) = (s for s in evaluation.scores if s.name == name)
    return found


def verdicts(*judged: tuple[int, int, float | None], criterion: str = "task_sequence_integrity") -> Evaluation:
    """Segments that lie on each other, each with the reference's verdict, the proposal's and its confidence."""
    spans = [(40 * k, 40 * k + 9) for k in range(len(judged))]
    return compared(
        [segment(*at, a, criterion=criterion) for at, (a, _, _) in zip(spans, judged, strict=True)],
        [segment(*at, b, confidence=c, criterion=criterion) for at, (_, b, c) in zip(spans, judged, strict=True)],
    )


def proposal(start: int, end: int, reward: int | None = 1, **fields: object) -> Segment:
    return segment(start, end, reward, **{"status": "proposed", "source": "vlm", "confidence": 0.8, **fields})


def shown(evaluation: Evaluation, width: int = 100) -> str:
    file = io.StringIO()
    for table in evaluation.tables():
        Console(file=file, width=width).print(table)
    return file.getvalue()


def picture(png: bytes) -> np.ndarray:
    """(height, width, 3)"""
    with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
        image.load()
        return np.asarray(image.convert("RGB")).astype(int)


def blue(pixels: np.ndarray) -> int:
    """How many pixels have the colour of points and lines."""
    return int((pixels[..., 2] - pixels[..., 0] > 60).sum())


def test_scores_by_hand():
    found = score(
        compared(
            [segment(0, 9, 1), segment(20, 29, 0), segment(40, 49, 1), segment(60, 69, None)],
            [
                segment(0, 9, 1, confidence=0.9),
                segment(22, 29, 1, confidence=0.6),  # 8 of 10 frames, begins 2 late, wrong
                segment(45, 54, 1, confidence=0.7),  # 5 of 15 frames: not found
                segment(58, 71, 1, confidence=0.8),  # 10 of 14 frames, begins 2 early, ends 2 late; no one decided it
                segment(80, 89, 1, confidence=0.5),
            ],
        )
    )
    assert (found.reference, found.proposed, found.found) == (4, 5, 3)
    assert found.f1 == pytest.approx(2 * (3 / 5) * (3 / 4) / (3 / 5 + 3 / 4))
    assert found.start_error == pytest.approx((0 + 2 + 2) / 3)
    assert found.end_error == pytest.approx((0 + 0 + 2) / 3)
    assert (found.verdicts, found.correct, found.accuracy) == (2, 1, 0.5)
    assert found.kappa == 0  # the machine says 1 always: no more than chance
    assert found.ece == pytest.approx((abs(1 - 0.9) + abs(0 - 0.6)) / 2)
    assert [(b.confidence, b.accuracy, b.count) for b in found.bins] == [(0.6, 0, 1), (0.9, 1, 1)]


@pytest.mark.parametrize(("end", "found"), [(4, 1), (3, 0), (19, 1), (20, 0)])
def test_half_of_the_frames_of_either_is_enough_and_less_is_not(end, found):
    assert score(compared([segment(0, 9)], [segment(0, end)])).found == found


def test_kappa_of_verdicts_by_hand():
    pairs = [(0, 0)] * 3 + [(0, 1)] + [(1, 0)] * 2 + [(1, 1)] * 4
    found = score(verdicts(*[(a, b, 0.5) for a, b in pairs]))
    assert (found.verdicts, found.accuracy) == (10, 0.7)
    assert found.kappa == pytest.approx((0.7 - 0.5) / (1 - 0.5))  # 0.4 * 0.5 + 0.6 * 0.5 by chance


def test_calibration_by_hand():
    error, bins = calibration_error([0.81, 0.89, 0.85, 0.95, 1.0], [True, False, True, True, True])
    assert [b.count for b in bins] == [3, 2]
    assert [b.confidence for b in bins] == pytest.approx([0.85, 0.975])
    assert [b.accuracy for b in bins] == pytest.approx([2 / 3, 1])
    assert error == pytest.approx((3 * (0.85 - 2 / 3) + 2 * 0.025) / 5)
    assert calibration_error([], []) == (None, ())


@given(st.lists(st.tuples(CONFIDENCE, st.booleans()), min_size=1, max_size=40))
def test_calibration_has_each_verdict_in_one_bin_and_no_bin_wider_than_a_tenth(judged):
    confidences, right = [c for c, _ in judged], [r for _, r in judged]
    error, bins = calibration_error(confidences, right)
    assert error is not None
    assert sum(b.count for b in bins) == len(judged)
    assert sum(b.count * b.confidence for b in bins) == pytest.approx(sum(confidences))
    assert sum(b.count * b.accuracy for b in bins) == pytest.approx(sum(right))
    assert len({min(int(b.confidence * BINS + 1e-9), BINS - 1) for b in bins}) == len(bins)
    # No more than if each verdict stood alone, no less than all together.
    assert error <= np.mean([abs(r - c) for c, r in judged]) + 1e-9
    assert error >= abs(np.mean(right) - np.mean(confidences)) - 1e-9
    assert calibration_error(confidences[::-1], right[::-1])[0] == pytest.approx(error)


@given(GAPS, GAPS)
def test_f1_is_symmetric_and_counts_each_segment_once(a, b):
    left, right = apart(a), apart(b)
    # An empty reference has no episode to compare in.
    one, other = score(compared(left, right if left else [])), score(compared(right, left if right else []))
    if left and right:
        assert one.f1 == other.f1
    # Of two halves of one segment, either may be the one that is found.
    if left and right and not any(temporal_iou(x, y) == 0.5 for x in left for y in right):
        assert (one.start_error, one.end_error) == (other.start_error, other.end_error)
        assert (one.verdicts, one.correct) == (other.verdicts, other.correct)
        assert one.kappa == pytest.approx(other.kappa)
    assert (one.reference, other.reference) == (len(left), len(right))
    assert one.found <= min(len(left), len(right))
    assert one.f1 is None or 0 <= one.f1 <= 1


@given(SPANS.filter(bool), st.data())
def test_a_perfect_copy_has_no_error_but_its_doubt(spans, data):
    own = [segment(s, s + more, r) for s, more, r in spans]
    sure = [data.draw(CONFIDENCE) for _ in spans]
    found = score(compared(own, [replace(one, confidence=c) for one, c in zip(own, sure, strict=True)]))
    assert (found.f1, found.start_error, found.end_error) == (1, 0, 0)
    decided = [c for c, one in zip(sure, own, strict=True) if one.reward is not None]
    # Of several on the same frames, any may be matched with any.
    if len({(s, more) for s, more, _ in spans}) == len(spans):
        assert found.accuracy == (1 if decided else None)
        assert (found.ece is None) == (not decided)
        if decided:
            assert found.ece == pytest.approx(np.mean([1 - c for c in decided]), abs=1e-9)


@example([10, 20, 10], [30, 10])
@given(st.lists(st.integers(1, 30), max_size=4), st.lists(st.integers(1, 30), max_size=4))
def test_what_overlaps_by_more_than_half_is_found(a, b):
    # Segments one after the other, so that each has one partner at most.
    ends = (np.cumsum([0, *a]).tolist(), np.cumsum([0, *b]).tolist())
    left, right = ([segment(s, e - 1) for s, e in pairwise(at)] for at in ends)
    pairs = sum(temporal_iou(x, y) > 0.5 for x in left for y in right)
    half = sum(temporal_iou(x, y) == 0.5 for x in left for y in right)
    if left:
        assert pairs <= score(compared(left, right)).found <= pairs + half
    close = score(compared([segment(0, 29), segment(30, 39)], [segment(0, 9), segment(10, 39)]))
    assert close.found == 1  # 20 frames of 40 are shared


def test_verdicts_without_confidence_are_right_or_wrong_but_not_calibrated():
    found = score(verdicts((1, 1, None), (1, 0, 0.75)))
    assert (found.verdicts, found.accuracy, found.ece) == (2, 0.5, 0.75)
    assert [b.count for b in found.bins] == [1]


def test_only_episodes_of_the_reference_count():
    own, there, elsewhere = segment(0, 9, episode_id="a"), segment(0, 9, episode_id="a"), segment(0, 9, episode_id="b")
    found = compared([own], [there, elsewhere])
    assert (found.episodes, score(found).proposed, score(found).f1) == (1, 1, 1)
    # Of an episode that counts, ITCs that the reference has not marked count as well.
    other = segment(0, 9, itc_id="t/other", episode_id="a")
    assert score(compared([own], [there, other])).f1 == pytest.approx(2 / 3)


def test_segments_of_different_itcs_and_episodes_never_meet():
    a = [segment(0, 9, episode_id="a"), segment(0, 9, episode_id="b", itc_id="t/x")]
    b = [segment(0, 9, episode_id="b"), segment(0, 9, episode_id="a", itc_id="t/x")]
    assert (score(compared(a, b)).found, compared(a, b).episodes) == (0, 2)


def test_criteria_stand_alone_then_by_kind_then_together():
    own = [segment(0, 9, criterion=c, itc_id=f"t/{c}", episode_id=c) for c in (*Criterion, "politeness")]
    found = compared(own, own[:3])
    assert [s.name for s in found.scores] == [
        "task sequence integrity",
        "target pose accuracy",
        "pose alignment",
        "collision free execution",
        "politeness",
        "process constraints",
        "fine spatial checks",
        "all",
    ]
    counts = {s.name: (s.reference, s.found) for s in found.scores}
    assert counts["process constraints"] == (2, 1)
    assert counts["fine spatial checks"] == (2, 2)
    assert counts["all"] == (5, 3)
    assert counts["politeness"] == (1, 0)


def test_nothing_at_all_has_no_figures():
    found = compared([], [])
    assert [s.name for s in found.scores] == ["process constraints", "fine spatial checks", "all"]
    assert (score(found).f1, score(found).accuracy, score(found).ece, score(found).kappa) == (None,) * 4
    assert "86.1%" in shown(found)


@pytest.mark.parametrize("width", [80, 140])
def test_the_papers_figures_stand_beside_ours(monkeypatch, width):
    process = verdicts((1, 1, 0.9), (1, 0, 0.9), (0, 0, 0.9), criterion="collision_free_execution")
    text = shown(process, width)
    for figure in ("86.1%", "235/273", "70.6%", "47.8%", "66.7%", "100.0%"):
        assert figure in text
    assert "vlm against ada, 1 episodes" in text
    assert "75.0%" in shown(replace(process, discovered=(3, 4)), width)
    monkeypatch.setenv("COLUMNS", str(width))
    assert all(figure in str(process) for figure in ("86.1%", "70.6%", "47.8%", "66.7%"))


def test_a_terminal_of_80_columns_shows_every_figure(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = str(verdicts((1, 1, 0.91), (1, 0, 0.63)))
    assert all(heading in shown for heading in ("ref.", "prop.", "F1", "start", "end", "right", "kappa", "ECE"))
    assert "0.36" in shown  # (0.09 + 0.63) / 2
    assert "mean absolute error" in " ".join(shown.split())


def test_figures_survive_json():
    found = replace(verdicts((1, 1, 0.9), (0, 1, 0.2)), discovered=(3, 4), files=(Path("a.json"), Path("a.png")))
    told = json.loads(found.to_json())
    assert told == json.loads(json.dumps(found.figures()))
    assert (told["proposer"], told["reference"], told["episodes"]) == ("vlm", "ada", 1)
    assert (told["discovered"], told["files"]) == ([3, 4], ["a.json", "a.png"])
    assert told["paper"]["G.1"] == {"accepted": 235, "proposed": 273}
    assert told["paper"]["G.2"] == {"process constraints": 0.706, "fine spatial checks": 0.478}
    for row, own in zip(told["scores"], found.scores, strict=True):
        bins = [{"confidence": b.confidence, "accuracy": b.accuracy, "count": b.count} for b in own.bins]
        assert (row["name"], row["f1"], row["accuracy"], row["ece"], row["bins"]) == (
            own.name,
            own.f1,
            own.accuracy,
            own.ece,
            bins,
        )


def test_a_labels_folder_is_evaluated_by_what_the_person_accepted(tmp_path):
    right, moved, wrong = proposal(0, 9, 1), proposal(40, 49, 0), proposal(80, 89, 1)
    write_proposals(tmp_path, "vlm", "ep", [right, moved, wrong], RECORDING)
    decided = [accept(right), segment(42, 51, 1, parent_id=moved.segment_id), reject(wrong)]
    Partition(tmp_path, "ada", "ep", RECORDING).apply("review", decided, based_on=0)
    found = evaluate(tmp_path, "vlm", "ada")
    whole = score(found)
    assert (found.proposer, found.reference, found.episodes) == ("vlm", "ada", 1)
    assert (whole.reference, whole.proposed, whole.found) == (2, 3, 2)
    assert (whole.start_error, whole.end_error, whole.accuracy) == (1, 1, 0.5)


def test_the_simulators_proposals_are_a_reference_too(tmp_path):
    write_proposals(tmp_path, "sim", "ep", [proposal(0, 9, 0, source="sim", confidence=1.0)], RECORDING)
    write_proposals(tmp_path, "vlm", "ep", [proposal(0, 9, 1)], RECORDING)
    whole = score(evaluate(tmp_path, "vlm", "sim"))
    assert (whole.f1, whole.accuracy, whole.ece) == (1, 0, 0.8)


def test_proposals_of_which_a_person_rejected_every_one_are_false(tmp_path):
    for name in ("good", "bad"):
        one = proposal(0, 9, 1, episode_id=name)
        write_proposals(tmp_path, "vlm", name, [one], RECORDING)
        decision = accept(one) if name == "good" else reject(one)
        Partition(tmp_path, "ada", name, RECORDING).apply("review", [decision], based_on=0)
    found = evaluate(tmp_path, "vlm", "ada")
    assert (found.episodes, score(found).proposed, score(found).f1) == (2, 2, pytest.approx(2 / 3))


def test_who_has_no_labels_is_told_who_has(tmp_path):
    with pytest.raises(
        LabelError, match=r"'vlm' has no labels in .*run `jiti autolabel --vlm` first\. There are: none"
    ):
        evaluate(tmp_path, "vlm", "ada")
    write_proposals(tmp_path, "vlm", "ep", [proposal(0, 9)], RECORDING)
    Partition(tmp_path, "ada", "ep", RECORDING).apply("mark", [segment(0, 9)], based_on=0)
    with pytest.raises(LabelError, match=r"'bob' has no labels in .*--evaluate\. There are: ada, vlm"):
        evaluate(tmp_path, "vlm", "bob")
    with pytest.raises(LabelError, match=r"'signal' has no labels in .*--from signal` first\. There are: ada, vlm"):
        evaluate(tmp_path, "signal", "ada")
    with pytest.raises(LabelError, match=r"'vlm' compared with itself says nothing"):
        evaluate(tmp_path, "vlm", "vlm")


def test_labels_that_cannot_be_read_are_named(tmp_path):
    write_proposals(tmp_path, "vlm", "ep", [proposal(0, 9)], RECORDING)
    path = segments_path(tmp_path, "ada", "ep")
    path.parent.mkdir()
    path.write_bytes(b"nothing")
    with pytest.raises(LabelError, match=r"annotator=ada/ep\.parquet"):
        evaluate(tmp_path, "vlm", "ada")


def test_figures_and_plot_are_written_beside_each_other(tmp_path):
    before = verdicts((1, 1, 0.9), (0, 1, 0.6))
    for _ in range(2):  # the second time they are replaced
        found = save(before, tmp_path / "evaluation")
    assert sorted(p.name for p in (tmp_path / "evaluation").iterdir()) == [
        "vlm-against-ada.json",
        "vlm-against-ada.png",
    ]
    figures, plot = found.files
    assert json.loads(figures.read_text()) == json.loads(found.to_json())
    assert json.loads(figures.read_text())["files"] == [str(figures), str(plot)]
    assert picture(plot.read_bytes()).shape[2] == 3
    assert f"Figures: {figures}" in str(found)
    assert f"Reliability plot: {plot}" in str(found)
    assert replace(found, files=()) == before


def test_the_plot_has_a_panel_for_each_that_has_verdicts():
    several = compared(
        [segment(0, 9, 1, criterion=c, itc_id=f"t/{c}") for c in Criterion],
        [
            segment(0, 9, 1, criterion=c, itc_id=f"t/{c}", confidence=0.75 if c.startswith("t") else None)
            for c in Criterion
        ],
    )
    # Two of four criteria with a confidence, both kinds, and all.
    assert picture(plot_png(several)).shape[1] == 5 * PANEL_PX
    assert plot_png(several) == plot_png(several)


def test_a_plot_of_one_bin_or_none_is_a_plot():
    one, none = (picture(plot_png(found)) for found in (verdicts((1, 1, 0.9)), verdicts()))
    assert one.shape[1] == 3 * PANEL_PX  # its criterion, its kind, all
    assert none.shape[:2] == (one.shape[0], 480)  # wider, for the names
    assert blue(one) > 200  # three points
    assert blue(none) == 0
    assert none.min() < 100  # the axes are there


def test_nothing_on_a_plot_is_cut_off():
    for found in (verdicts((1, 1, 0.9)), verdicts()):
        pixels = picture(plot_png(found))
        assert pixels[:, :2].min() == pixels[:, -2:].min() == 255


def test_without_matplotlib_the_figures_are_there_and_the_plot_is_missed(tmp_path, monkeypatch):
    monkeypatch.setattr("jiti.annotate.reliability.find_spec", lambda _name: None)
    found = save(verdicts((1, 1, 0.9)), tmp_path / "evaluation")
    assert [path.name for path in tmp_path.rglob("*.*")] == ["vlm-against-ada.json"]
    assert "pip install 'jiti[vlm]'" in str(found)
