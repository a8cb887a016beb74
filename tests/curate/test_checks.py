"""Each kind of mistake is found where it is, and nothing is found where there is none."""

import json
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.labels import Labels, read_labels
from jiti.annotate.labels_cache import RECORDINGS
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment
from jiti.curate.checks import CHUNK_FRAMES, FLIP_FRAMES, find_suspects
from jiti.curate.suspects import WEIGHTS, Suspect
from jiti.errors import SourceError
from tests.builders.labels import RECORDING, segment, table


def labels(*rows: tuple[str, Segment], frames: int = 300) -> Labels:
    """Labels of recordings of one length, each annotator having a file for each episode."""
    files = sorted({(who, row.episode_id) for who, row in rows})
    about = [
        {"annotator": w, "episode_id": e, "frame_count": frames, "frame_rate_hz": 30.0, "fingerprint": "f"}
        for w, e in files
    ]
    return Labels(table(*rows), pa.Table.from_pylist(about, schema=RECORDINGS))


def found(*rows: tuple[str, Segment], **options: object) -> list[Suspect]:
    return find_suspects(labels(*rows), **options)  # pyright: ignore[reportArgumentType]


def good(episode_id: str = "ok", start: int = 100, **fields: object) -> list[tuple[str, Segment]]:
    """A satisfied and a violated segment, far apart."""
    return [
        ("anna", segment(start, start + 24, 1, episode_id=episode_id, **fields)),
        ("anna", segment(start + 60, start + 84, 0, episode_id=episode_id, **fields)),
    ]


def test_nothing_is_wrong_with_good_labels_or_none() -> None:
    assert found(*good()) == []
    assert found() == []


def test_an_itc_that_is_never_satisfied() -> None:
    rows = [("anna", segment(20, 50, 0, episode_id=name, itc_id="t/x")) for name in ("a", "b", "b2")]
    [suspect] = found(*rows, *good())
    assert (suspect.kind, suspect.severity, suspect.itc_id) == ("never_positive", "error", "t/x")
    assert (suspect.episode_id, suspect.segment_id, suspect.start_frame) == ("a", rows[0][1].segment_id, 20)
    assert "t/x is never satisfied: all 3 segments in 3 episodes are violated" in suspect.message
    [few] = found(*rows[:2], *good())
    assert few.severity == "warning"
    passing = ("anna", segment(200, 230, 1, episode_id="a", itc_id="t/x"))
    assert found(*rows, passing, *good()) == []
    not_decided = ("anna", segment(200, 230, 1, episode_id="a", itc_id="t/x", status="rejected"))
    assert [s.kind for s in found(*rows, not_decided, *good())] == ["never_positive"]


def test_an_itc_that_is_never_violated_ranks_lower() -> None:
    rows = [("anna", segment(20, 50, 1, episode_id=f"e{k}", itc_id="t/x")) for k in range(10)]
    [suspect] = found(*rows)
    assert (suspect.kind, suspect.severity) == ("never_negative", "warning")
    assert found(*rows[:9]) == []
    failing = [("anna", segment(20, 50, 0, episode_id=f"e{k}", itc_id="t/y")) for k in range(10)]
    assert [s.kind for s in found(*rows, *failing)] == ["never_positive", "never_negative"]


@pytest.mark.parametrize(("start", "end", "look_at"), [(280, 300, 280), (0, 5000, 0), (300, 330, 299), (500, 540, 299)])
def test_a_segment_outside_the_episode(start: int, end: int, look_at: int) -> None:
    row = segment(start, end, 1)
    [suspect] = found(("anna", row), *good())
    assert (suspect.kind, suspect.severity, suspect.segment_id) == ("outside_episode", "error", row.segment_id)
    assert suspect.start_frame == look_at  # a frame that can be shown
    assert f"frames {start} to {end}, but the episode has 300 frames" in suspect.message
    assert found(("anna", segment(start, end, 1, status="rejected")), *good()) == []


def test_the_last_frame_is_inside_and_a_shorter_recording_is_noticed() -> None:
    rows = [("anna", segment(280, 299, 1)), ("anna", segment(100, 120, 0))]
    assert found(*rows) == []
    shorter = {"ep": Recording(299, 30.0, "f")}
    assert [s.kind for s in found(*rows, recordings=shorter)] == ["outside_episode"]


@settings(deadline=None)
@given(st.integers(1, 2 * CHUNK_FRAMES))
def test_a_segment_shorter_than_the_chunk(frames: int) -> None:
    suspects = found(("anna", segment(50, 49 + frames, 1)), *good())
    assert [s.kind for s in suspects] == (["too_short"] if frames < CHUNK_FRAMES else [])
    if suspects:
        assert f"{frames} frames long, shorter than an action chunk of 10" in suspects[0].message
        assert suspects[0].start_frame == 50


@settings(deadline=None)
@given(st.integers(-30, 20), st.booleans(), st.booleans())
def test_verdicts_that_flip_or_contradict(gap: int, first_passes: bool, longer_before: bool) -> None:
    first, second = segment(100, 129, int(first_passes)), segment(130 + gap, 170 + gap, 1 - first_passes)
    before = [("anna", segment(40, 60, int(first_passes)))] if longer_before else []
    suspects = found(*before, ("anna", second), ("anna", first), *good(episode_id="ok", itc_id="t/other"))
    later = max(first, second, key=lambda s: s.start_frame)
    if gap < 0:
        assert [(s.kind, s.severity) for s in suspects] == [("contradiction", "error")]
        if gap > -30:
            assert f"frames {130 + gap} to 129 are both" in suspects[0].message
    else:
        assert [s.kind for s in suspects] == (["flip"] if gap <= FLIP_FRAMES else [])
    if suspects and gap > -30:
        assert (suspects[0].segment_id, suspects[0].start_frame) == (later.segment_id, later.start_frame)


def test_a_contradiction_hidden_behind_a_shorter_segment_is_found() -> None:
    rows = [segment(100, 200, 1), segment(110, 120, 1), segment(150, 160, 0)]
    [suspect] = found(*(("anna", row) for row in rows))
    assert (suspect.kind, suspect.segment_id) == ("contradiction", rows[2].segment_id)
    assert "frames 150 to 160 are both satisfied and violated" in suspect.message


def test_other_itcs_annotators_and_episodes_do_not_contradict() -> None:
    rows = [
        ("anna", segment(100, 130, 1)),
        ("anna", segment(100, 130, 0, itc_id="t/other")),
        ("anna", segment(100, 130, 0, episode_id="ep2")),
        ("anna", segment(10, 40, 1, episode_id="ep3", itc_id="t/other")),
    ]
    assert found(*rows) == []


def test_a_segment_without_verdict() -> None:
    row = segment(50, 80, None)
    [suspect] = found(("anna", row), *good())
    assert (suspect.kind, suspect.severity, suspect.segment_id) == ("undecided", "warning", row.segment_id)
    proposal = ("vlm", segment(50, 80, None, status="proposed", source="vlm"))
    assert found(proposal, *good()) == []


def test_annotators_who_disagree_until_it_is_settled() -> None:
    rows = [
        ("anna", segment(100, 129, 1)),
        ("bob", segment(120, 150, 0)),
        ("cleo", segment(110, 125, 1)),
        *good(),
    ]
    [suspect] = found(*rows)
    assert (suspect.kind, suspect.severity, suspect.annotator) == ("disagreement", "error", "anna / cleo / bob")
    assert suspect.message == "satisfied to anna, cleo, violated to bob, over 10 frames"
    assert (suspect.episode_id, suspect.start_frame) == ("ep", 120)
    assert found(*rows, ("adjudicated", segment(100, 129, 1))) == []
    assert found(("anna", segment(100, 129, 1)), ("bob", segment(100, 129, 1)), *good()) == []


def test_differences_beside_a_settled_one_stay_in_the_check() -> None:
    first, second = segment(100, 129, 1), segment(200, 229, 1)
    against = [segment(100, 140, 0), segment(200, 229, 0)]
    rows = [("anna", first), ("anna", second), *(("bob", row) for row in against)]
    assert [(s.kind, s.start_frame) for s in found(*rows)] == [("disagreement", 100)]
    taken = segment(100, 129, 1, parent_id=first.segment_id)
    dropped = segment(100, 140, 0, parent_id=against[0].segment_id, status="rejected")
    rows += [("adjudicated", taken), ("adjudicated", dropped)]
    [suspect] = found(*rows)
    assert (suspect.kind, suspect.severity, suspect.start_frame) == ("disagreement", "error", 200)
    assert suspect.message == "satisfied to anna, violated to bob, over 30 frames"


def test_a_return_far_from_what_is_usual() -> None:
    rows = []
    for number in range(12):
        rows += good(f"e{number:02}", start=100 + number)
    assert found(*rows) == []
    odd = [("anna", segment(20, 250, 1, episode_id="odd")), ("anna", segment(270, 290, 0, episode_id="odd"))]
    [suspect] = found(*rows, *odd)
    assert (suspect.kind, suspect.severity, suspect.episode_id) == ("return_outlier", "warning", "odd")
    assert suspect.start_frame == 20
    usual, highest = (1 - 0.98**25) / 0.02, (1 - 0.98**231) / 0.02
    assert suspect.message == f"its highest return is {highest:.1f}, usual for t is {usual:.1f}"
    assert found(*rows[:12], *odd) == []  # six episodes have no usual return
    elsewhere = [(who, segment(20, 250, 1, episode_id="odd", itc_id="other/x")) for who in ("anna",)]
    assert found(*rows, *elsewhere) == []  # another task


def test_labels_of_another_recording() -> None:
    rows = [*good("ep"), ("bob", segment(100, 124, 1, episode_id="ep"))]
    assert found(*rows, recordings={"ep": Recording(300, 30.0, "f"), "more": RECORDING}) == []
    suspects = found(*rows, recordings={"ep": Recording(310, 30.0, "g")})
    assert [(s.kind, s.severity, s.annotator) for s in suspects] == [
        ("other_recording", "error", "anna"),
        ("other_recording", "error", "bob"),
    ]
    assert "300 frames with fingerprint f; the one here has 310 frames and fingerprint g" in suspects[0].message


def test_annotators_who_labelled_different_recordings(tmp_path: Path) -> None:
    for annotator, fingerprint in (("anna", "a"), ("bob", "b")):
        recording = Recording(300, 30.0, fingerprint)
        rows = [segment(100, 124, 1), segment(160, 184, 0)]
        Partition(tmp_path, annotator, "ep", recording).apply("mark", rows, based_on=0)
    [suspect] = find_suspects(read_labels(tmp_path))
    assert (suspect.kind, suspect.annotator) == ("other_recording", "bob")
    assert suspect.message == "bob and anna labelled different recordings under this name"


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    Partition(tmp_path, "anna", "ep", RECORDING).apply("mark", [segment()], based_on=0)
    path = tmp_path / "segments" / "annotator=anna" / "ep.parquet"
    path.write_bytes(b"junk")
    [suspect] = find_suspects(read_labels(tmp_path))
    assert (suspect.kind, suspect.severity) == ("unreadable_labels", "error")
    assert str(path) in suspect.message
    assert "rebuilds the file" in suspect.remedy


def test_errors_come_first_then_the_higher_score() -> None:
    rows = [
        ("anna", segment(50, 80, None, episode_id="a")),
        ("anna", segment(290, 320, 1, episode_id="b")),
        ("anna", segment(10, 12, 1, episode_id="c")),
        ("anna", segment(10, 16, 1, episode_id="d")),
        *good(),
    ]
    suspects = found(*rows)
    assert [(s.kind, s.episode_id) for s in suspects] == [
        ("outside_episode", "b"),
        ("too_short", "c"),
        ("too_short", "d"),
        ("undecided", "a"),
    ]
    assert all(0 < s.score <= WEIGHTS[s.kind] for s in suspects)
    assert json.loads(json.dumps([s.to_json() for s in suspects]))[0]["episode_id"] == "b"
    assert all(s.remedy.endswith(".") for s in suspects)


rows = st.lists(
    st.builds(
        lambda who, start, more, reward, status, itc, episode: (
            who,
            segment(start, start + more, reward, status=status, itc_id=itc, episode_id=episode),
        ),
        st.sampled_from(["anna", "bob", "adjudicated"]),
        st.integers(0, 400),
        st.integers(0, 60),
        st.sampled_from([None, 0, 1]),
        st.sampled_from(["accepted", "rejected", "proposed"]),
        st.sampled_from(["t/x", "t/y"]),
        st.sampled_from(["a", "b"]),
    ),
    max_size=15,
)


@settings(deadline=None)
@given(rows)
def test_any_labels_are_checked_in_the_same_way_in_any_order(rows: list[tuple[str, Segment]]) -> None:
    suspects = found(*rows)
    places = {(row.episode_id, row.segment_id) for _, row in rows}
    for suspect in suspects:
        assert suspect.kind in WEIGHTS
        assert 0 <= suspect.score <= 1
        assert not suspect.segment_id or (suspect.episode_id, suspect.segment_id) in places
        json.dumps(suspect.to_json())
    by_id = sorted(rows, key=lambda one: one[1].segment_id, reverse=True)
    kinds = [(s.kind, s.severity, s.episode_id, s.itc_id) for s in found(*by_id)]
    ignored = ("never_positive", "never_negative")  # these show any one of their segments
    assert sorted(k for k in kinds if k[0] not in ignored) == sorted(
        (s.kind, s.severity, s.episode_id, s.itc_id) for s in suspects if s.kind not in ignored
    )


def wave(phase: float, frames: int = 100) -> np.ndarray:
    """A trajectory (frames, 2)."""
    place = np.linspace(0, 2 * np.pi, frames)
    return np.stack([np.sin(place + phase), np.cos(2 * place + phase)], axis=1)


def test_near_identical_trajectories_with_opposite_verdicts() -> None:
    rows = [
        ("anna", segment(100, 130, 1, episode_id="twin-1")),
        ("anna", segment(40, 60, 1, episode_id="twin-2")),
        ("anna", segment(100, 130, 0, episode_id="twin-2")),
        ("anna", segment(100, 130, 0, episode_id="other")),
        ("anna", segment(100, 130, 1, episode_id="third")),
    ]
    paths = {"twin-1": wave(0), "twin-2": wave(0.01, 140), "other": wave(1.5), "third": wave(3)}
    [suspect] = found(*rows, trajectories=paths.__getitem__)
    assert (suspect.kind, suspect.severity, suspect.episode_id) == ("near_identical", "warning", "twin-2")
    assert (suspect.itc_id, suspect.start_frame) == ("t/hold", 100)
    assert suspect.message == "violated here, satisfied in twin-1, which went nearly the same way"
    scaled = {name: path * [1000, 0.001] + 5 for name, path in paths.items()}
    assert found(*rows, trajectories=scaled.__getitem__) == [suspect]  # whatever the units are
    same_verdict = [(who, row.changed(reward=1)) for who, row in rows]
    assert found(*same_verdict, trajectories=paths.__getitem__) == []


def test_trajectories_that_cannot_be_compared() -> None:
    rows = [
        ("anna", segment(100, 130, 1, episode_id="a")),
        ("anna", segment(100, 130, 0, episode_id="b")),
        ("anna", segment(100, 130, 0, episode_id="gone")),
        ("anna", segment(100, 130, 0, episode_id="arm-of-7")),
        ("anna", segment(100, 130, 0, episode_id="nothing")),
    ]

    def trajectory(episode_id: str) -> np.ndarray:
        if episode_id == "gone":
            raise SourceError("gone.mcap is not there. Restore it.")
        if episode_id == "arm-of-7":
            return np.zeros((50, 7))
        if episode_id == "nothing":
            return np.empty((0, 2))
        return np.full((50, 2), np.nan)

    [suspect] = found(*rows, trajectories=trajectory)
    assert (suspect.kind, suspect.episode_id) == ("unreadable_recording", "gone")
    assert suspect.message == "gone.mcap is not there. Restore it"  # the remedy follows after a full stop


def test_work_is_bounded_for_large_datasets() -> None:
    rows = [("anna", segment(100, 130, k % 2, episode_id=f"e{k:05}")) for k in range(4000)]
    read = []

    def trajectory(episode_id: str) -> np.ndarray:
        read.append(episode_id)
        return np.random.default_rng(int(episode_id[1:])).random((50, 7))

    begin = time.process_time()
    find_suspects(labels(*rows), trajectories=trajectory)
    assert len(read) == len(set(read)) == 2000
    parities = [int(name[1:]) % 2 for name in read]
    assert 800 < sum(parities) < 1200  # of both verdicts
    assert time.process_time() - begin < 10  # about 0.5 s
