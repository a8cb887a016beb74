"""What a model said about an episode is written down, read back to the letter, and forgotten when it is of no use."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.vlm.answers import Span
from jiti.annotate.vlm.notes import UNDECIDED, Decision, ItcNotes, Notes, notes_path, read_notes, write_notes
from jiti.errors import LabelError, SaveFailed

SPAN = Span(1.0, 2.5, "the gripper opens")
FAILED = Decision(None, None, "", failure="the server is gone")
YES = Decision(True, 0.875, "it rests", samples=3)
TEXTS = st.text(max_size=40)
SECONDS = st.floats(0, 1e5)
DECISIONS = st.builds(
    Decision,
    st.none() | st.booleans(),
    st.none() | st.floats(0, 1),
    TEXTS,
    by=st.sampled_from(["vlm", "numbers"]),
    frame=st.none() | st.integers(0, 10**6),
    samples=st.integers(0, 50),
    failure=TEXTS,
)
ITCS = st.builds(
    ItcNotes,
    TEXTS,
    st.lists(st.builds(Span, SECONDS, SECONDS, TEXTS), max_size=3),
    TEXTS,
    TEXTS,
    st.lists(DECISIONS, max_size=3),
)


@given(itcs=st.dictionaries(TEXTS, ITCS, max_size=3), fingerprint=TEXTS, model=TEXTS)
@settings(max_examples=40, deadline=None)
def test_notes_come_back_from_their_file(tmp_path_factory, itcs, fingerprint, model):
    path = tmp_path_factory.mktemp("labels") / "vlm" / "notes" / "a.json"
    notes = Notes(fingerprint, itcs=itcs)
    notes.model = model
    write_notes(path, notes)
    assert read_notes(path, fingerprint) == notes


def test_notes_on_other_bytes_are_forgotten(tmp_path):
    path = tmp_path / "a.json"
    write_notes(path, Notes("before", itcs={"x": ItcNotes("key", [SPAN])}))
    assert read_notes(path, "after") == Notes("after")
    assert read_notes(path, "before").itcs["x"].spans == [SPAN]


def test_an_episode_that_was_never_asked_about_has_empty_notes(tmp_path):
    assert read_notes(tmp_path / "none" / "a.json", "f") == Notes("f")


def whole() -> str:
    return json.dumps(
        {
            "fingerprint": "f",
            "itcs": {
                "x": {
                    "located": "k",
                    "spans": [{"start_s": 1.0, "end_s": 2.5, "evidence": "the gripper opens"}],
                    "located_failure": "",
                    "decided": "d",
                    "decisions": [{"satisfied": True, "confidence": 0.875, "rationale": "it rests", "samples": 3}],
                    "measured": None,
                }
            },
        }
    )


def test_a_file_by_hand_is_read(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(whole())
    assert read_notes(path, "f").itcs == {"x": ItcNotes("k", [SPAN], "", "d", [YES])}


@pytest.mark.parametrize(
    "text",
    [
        "",
        whole()[:-1],
        "null",
        "[]",
        "7",
        '"f"',
        "{}",
        '{"fingerprint": "f"}',
        whole().replace('"fingerprint": "f"', '"fingerprint": null'),
        whole().replace('"itcs": {', '"itcs": [], "other": {'),
        whole().replace('"x": {', '"x": null, "y": {'),
        whole().replace('"located": "k"', '"place": "k"'),
        whole().replace('"evidence"', '"seen"'),
        whole().replace('"end_s": 2.5, ', ""),
        whole().replace('"samples": 3', '"votes": 3'),
        whole().replace('"spans": [{', '"spans": [null, {'),
    ],
)
def test_a_damaged_file_counts_as_never_asked(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    assert read_notes(path, "f") == Notes("f")


def test_bytes_that_are_no_text_count_as_never_asked(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"\xff\x00" * 50)
    assert read_notes(path, "f") == Notes("f")


def test_a_stage_is_done_when_it_was_asked_so_and_did_not_fail():
    done = ItcNotes("k", [SPAN], "", "d", [YES])
    assert done.has_spans("k")
    assert done.has_decisions("d")
    assert not done.has_spans("other")
    assert not done.has_decisions("other")
    assert not ItcNotes("k", [], "no answer").has_spans("k")
    assert not ItcNotes("k", [SPAN], "", "d", [YES, FAILED]).has_decisions("d")
    assert not ItcNotes().has_spans("k")


def test_failures_are_told_by_stage():
    assert ItcNotes("k", [SPAN], "", "d", [YES]).failures == []
    assert ItcNotes("k", [], "no answer").failures == ["segments: no answer"]
    assert ItcNotes("k", [SPAN] * 3, "", "d", [FAILED, YES, FAILED]).failures == ["verdict: the server is gone"] * 2
    assert ItcNotes("k", [SPAN], "", "", [UNDECIDED]).failures == []


def test_an_episodes_notes_have_their_own_file_inside_the_labels():
    labels = Path("labels")
    assert notes_path(labels, "a.mcap") == labels / "vlm" / "notes" / "a.mcap.json"
    assert notes_path(labels, "a.mcap") != notes_path(labels, "b.mcap")
    for bad in ("../a", "a/b", "", ".hidden"):
        with pytest.raises(LabelError):
            notes_path(labels, bad)


def test_a_disk_that_refuses_is_said(tmp_path):
    (tmp_path / "notes").write_text("in the way")
    with pytest.raises(SaveFailed):
        write_notes(tmp_path / "notes" / "a.json", Notes("f"))


def test_a_failure_with_half_a_character_is_written(tmp_path):
    path = tmp_path / "a.json"
    write_notes(path, Notes("f", itcs={"x": ItcNotes("k", [], "the server said \ud83d")}))
    assert read_notes(path, "f").itcs["x"].located_failure == "the server said \ud83d"
