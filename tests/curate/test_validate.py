"""Labels of recordings that are gone or damaged are errors, and what a terminal shows is what was found."""

import shutil
from pathlib import Path

import pytest

from jiti.annotate.segment_file import Recording
from jiti.annotate.store import LabelStore
from jiti.annotate.web.session import Session, open_session
from jiti.curate.validate import Check, check_labels, print_check
from jiti.episodes.reader import open_reader
from tests.builders.labels import segment
from tests.builders.mcap import write_mcap


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three short recordings, a satisfied and a violated segment in each."""
    folder = tmp_path_factory.mktemp("made") / "d[red]x"
    folder.mkdir()
    for name in ("a", "b", "c"):
        write_mcap(folder / f"{name}.mcap", cameras={}, duration_s=2)
        episode = open_reader(folder).open(name)
        about = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
        rows = [segment(0, 14, int(name != "b"), episode_id=name), segment(30, 44, 0, episode_id=name)]
        LabelStore(folder / "labels").partition("anna", name, about).apply("mark", rows, based_on=0)
    return folder


@pytest.fixture
def folder(recordings: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recordings, tmp_path / recordings.name))


def session(source: Path) -> Session:
    return open_session(str(source), annotator="anna", labels=None, tasks=None)


def lost(check: Check) -> dict[str, str]:
    return {s.episode_id: s.message for s in check.suspects if s.kind == "unreadable_recording"}


def test_labels_of_recordings_that_are_all_there(folder: Path) -> None:
    check = check_labels(session(folder), gamma=0.98)
    assert (check.labelled, check.episodes, check.segments, lost(check)) == (3, 3, 6, {})


def test_labelled_recordings_that_are_gone_or_do_not_open_are_errors(folder: Path) -> None:
    (folder / "a.mcap").unlink()
    (folder / "b.mcap").write_bytes(b"no recording")
    check = check_labels(session(folder), gamma=0.98)
    assert (check.labelled, check.episodes) == (2, 2)
    assert "no such recording" in lost(check)["a"]
    assert "cannot be opened" in lost(check)["b"]
    errors = [s for s in check.suspects if s.kind == "unreadable_recording"]
    assert [(s.episode_id, s.severity, s.annotator) for s in errors] == [("a", "error", "anna"), ("b", "error", "anna")]
    assert all("Restore the recording, or remove its labels" in s.remedy for s in errors)


def test_one_file_is_checked_without_the_labels_of_its_neighbours(folder: Path) -> None:
    check = check_labels(session(folder / "a.mcap"), gamma=0.98)
    assert (check.labelled, check.episodes, check.segments, lost(check)) == (1, 1, 2, {})


def test_what_is_printed_keeps_brackets_and_single_full_stops(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "b.mcap").write_bytes(b"no recording")
    print_check(check_labels(session(folder), gamma=0.98))
    printed = capsys.readouterr().out
    assert "d[red]x" in printed.splitlines()[0]
    assert "b, frame 0, anna: it cannot be opened: " in printed
    assert ".." not in printed
