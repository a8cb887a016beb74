from pathlib import Path

import pytest

from jiti.annotate.confirm import confirm_recordings
from jiti.annotate.labels import read_labels
from jiti.annotate.web.session import Session, open_session
from jiti.errors import LabelError
from tests.builders.curate import mark, propose, recording_of, write_picks


def session_of(folder: Path) -> Session:
    return open_session(str(folder), annotator="ann", labels=None, tasks=None)


@pytest.fixture
def demos(tmp_path: Path) -> Path:
    """Two recordings, labelled by a person and a machine; the first, of 30 frames, was changed since."""
    folder = write_picks(tmp_path / "demos", [[(5, 14, 1)], [(5, 14, 1)]])
    propose(folder, "pick_0", [(16, 25, 0)])
    write_picks(folder, [None], instruction="pick the red cube")
    return folder


def test_labels_become_those_of_the_recordings_that_are_here(demos):
    before = read_labels(demos / "labels")
    now = recording_of(demos, "pick_0").fingerprint
    assert now not in before.recordings["fingerprint"].to_pylist()
    assert confirm_recordings(session_of(demos)) == ["pick_0"]
    after = read_labels(demos / "labels").whole()
    found = zip(*(after.recordings[c].to_pylist() for c in ("annotator", "episode_id", "fingerprint")), strict=True)
    other = recording_of(demos, "pick_1").fingerprint
    assert set(found) == {("ann", "pick_0", now), ("sim", "pick_0", now), ("ann", "pick_1", other)}
    assert after.segments.equals(before.segments)
    assert confirm_recordings(session_of(demos)) == []


def test_a_segment_that_no_longer_fits_is_told_and_nothing_is_written(demos):
    mark(demos, "pick_1", [(20, 33, 1)], annotator="ben")
    before = read_labels(demos / "labels").recordings
    (demos / "pick_1.mcap").write_bytes((demos / "pick_0.mcap").read_bytes())
    with pytest.raises(LabelError, match="pick_1 has 30 frames, and a segment that ends at frame 33"):
        confirm_recordings(session_of(demos))
    assert read_labels(demos / "labels").recordings.equals(before)
