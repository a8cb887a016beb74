"""Damaged, lagging, missing and newer files; disks that refuse."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.partition import Partition, View
from jiti.errors import LabelError, NewerSchema, SaveFailed
from tests.builders.labels import RECORDING, full_disk, names_in, ordinary_user, segment


class Labels:
    """A partition with some edits, and copies of its files at every version."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.history = folder / "history" / "annotator=anna" / "ep.jsonl"
        self.parquet = folder / "segments" / "annotator=anna" / "ep.parquet"
        partition = Partition(folder, "anna", "ep", RECORDING)
        self.views: list[View] = [partition.view]
        self.histories = [b""]
        self.parquets = [b""]

        def done(version: int) -> None:
            assert version == len(self.views)
            self.views.append(partition.view)
            self.histories.append(self.history.read_bytes())
            self.parquets.append(self.parquet.read_bytes())

        done(partition.apply("mark", [segment(10, 34), segment(40, 64, 0, rationale="slips")], based_on=0))
        done(partition.apply("mark", [segment(100, 124)], based_on=1))
        done(partition.apply("nudge", [partition.segments[0].changed(start_frame=11)], based_on=2))
        done(partition.undo(based_on=3))
        done(partition.apply("delete", remove=[partition.segments[1].segment_id], based_on=4))
        done(partition.apply("verdict", [partition.segments[0].changed(reward=0)], based_on=5))

    def open(self, history: bytes | None = None, parquet: bytes | None = None) -> Partition:
        """As another process finds it, with the files replaced; b"" takes one away."""
        for path, data in ((self.history, history), (self.parquet, parquet)):
            if data == b"":
                path.unlink(missing_ok=True)
            elif data is not None:
                path.write_bytes(data)
        return Partition(self.folder, "anna", "ep", RECORDING)

    def damaged(self) -> list[bytes]:
        return [path.read_bytes() for path in sorted(self.folder.rglob(".*.damaged-*"))]


@pytest.fixture
def labels(tmp_path: Path) -> Labels:
    return Labels(tmp_path / "labels")


@pytest.fixture(scope="module")
def shared_labels() -> Iterator[Labels]:
    with tempfile.TemporaryDirectory() as name:
        yield Labels(Path(name))


def test_a_parquet_file_of_any_earlier_version_is_brought_up_to_date(labels: Labels) -> None:
    for version, parquet in enumerate(labels.parquets[:-1]):
        partition = labels.open(parquet=parquet)
        assert partition.view == labels.views[-1]
        assert labels.parquet.read_bytes() == labels.parquets[-1]
        expected = f"held edits up to {version} of 6" if parquet else "was missing"
        assert [expected in problem.what for problem in partition.problems] == [True]
        assert labels.open().problems == ()
    assert labels.damaged() == []


@pytest.mark.parametrize("data", [b"PAR1", b"\0" * 3000, b"not parquet at all", None])
def test_a_damaged_parquet_file_is_rebuilt_and_kept_aside(labels: Labels, data: bytes | None) -> None:
    data = data or labels.parquets[-1][:-100]
    partition = labels.open(parquet=data)
    assert partition.view == labels.views[-1]
    assert labels.parquet.read_bytes() == labels.parquets[-1]
    assert labels.damaged() == [data]
    assert len(partition.problems) == 1
    assert "cannot be read as segments" in str(partition.problems[0])
    assert "rebuilt from the history; the old file is kept" in str(partition.problems[0])
    assert partition.undo(based_on=6) == 7
    assert partition.segments == labels.views[5].segments


def test_a_foreign_parquet_file_does_not_take_the_place_of_labels(labels: Labels) -> None:
    pq.write_table(pa.table({"a": [1]}), labels.parquet)
    assert labels.open().view == labels.views[-1]
    table = pq.ParquetFile(labels.parquet).read().slice(1)
    pq.write_table(table.replace_schema_metadata(), labels.parquet)
    partition = labels.open()
    assert partition.view == labels.views[-1]
    assert "replaced by a file that is not jiti's" in partition.problems[0].what
    assert len(labels.damaged()) == 2


def test_a_parquet_file_alone_is_enough_to_go_on(labels: Labels) -> None:
    partition = labels.open(history=b"")
    assert partition.segments == labels.views[-1].segments
    assert (partition.version, partition.can_undo, partition.recording) == (6, False, RECORDING)
    partition.apply("mark", [segment(200, 224)], based_on=6)
    again = labels.open()
    assert again.view == partition.view
    assert again.problems == ()
    assert again.undo(based_on=7) == 8
    assert again.segments == labels.views[-1].segments
    assert labels.open(parquet=b"").segments == labels.views[-1].segments  # the new history stands by itself


def test_an_older_history_takes_the_rest_from_the_parquet_file(labels: Labels) -> None:
    for version, history in enumerate(labels.histories[1:-1], 1):
        partition = labels.open(history=history, parquet=labels.parquets[-1])
        assert partition.segments == labels.views[-1].segments
        assert partition.version == 6
        assert f"held edits up to {version} of 6" in partition.problems[0].what
        assert labels.open().view == partition.view
        assert labels.open().problems == ()
        assert labels.open(parquet=b"").segments == labels.views[-1].segments
        again = labels.open()
        again.undo(based_on=6)
        assert again.segments == labels.views[version].segments


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_torn_last_line_was_not_acknowledged(shared_labels: Labels, data: st.DataObject) -> None:
    labels = shared_labels
    version = data.draw(st.integers(1, 5))
    size = data.draw(st.integers(len(labels.histories[version]), len(labels.histories[version + 1]) - 1))
    partition = labels.open(labels.histories[version + 1][:size], labels.parquets[version])
    assert partition.view == labels.views[version]
    assert partition.problems == ()
    if partition.can_undo:
        partition.undo(based_on=version)
        assert labels.open().view == partition.view
        assert labels.open().problems == ()


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_any_wrong_byte_in_either_file_loses_no_label(shared_labels: Labels, data: st.DataObject) -> None:
    labels = shared_labels
    files = [labels.histories[-1], labels.parquets[-1]]
    which = data.draw(st.integers(0, 1))
    place = data.draw(st.integers(0, len(files[which]) - 1))
    byte = data.draw(st.integers(0, 255).filter(lambda b: b != files[which][place]))
    files[which] = files[which][:place] + bytes([byte]) + files[which][place + 1 :]
    for leftover in labels.folder.rglob(".*.damaged-*"):
        leftover.unlink()
    try:
        partition = labels.open(*files)
    except NewerSchema:
        assert bytes([byte]) in b"23456789"  # the schema version itself was hit
        return
    assert partition.segments == labels.views[-1].segments
    again = labels.open()
    assert again.segments == labels.views[-1].segments
    assert again.problems == ()
    assert labels.open(parquet=b"").segments == labels.views[-1].segments


def test_a_bad_line_in_the_middle_is_an_error_when_the_parquet_file_cannot_stand_in(labels: Labels) -> None:
    lines = labels.histories[-1].splitlines(keepends=True)
    history = b"".join([*lines[:4], b"garbage\n", *lines[5:]])
    for parquet in (b"", labels.parquets[3], b"PAR1 damaged"):
        with pytest.raises(
            LabelError, match=r"ep\.jsonl, line 5 is damaged, and .*ep\.parquet .*Restore one of the two"
        ):
            labels.open(history, parquet)
        assert labels.history.read_bytes() == history
        assert labels.damaged() == []
    for version in (4, 5, 6):
        partition = labels.open(history, labels.parquets[version])
        assert partition.segments == labels.views[6].segments
        assert partition.version == 6
        assert "line 5 is damaged" in partition.problems[0].what
        assert "undo reaches back to edit 4" in partition.problems[0].remedy
        assert labels.damaged()[-1] == history
        again = labels.open(parquet=b"")  # the mended history stands by itself
        assert again.segments == labels.views[6].segments
        again.undo(based_on=6)
        again.undo(based_on=7)
        assert again.segments == labels.views[4].segments
        assert not again.can_undo


def test_both_files_damaged_is_an_error_that_keeps_them(labels: Labels) -> None:
    with pytest.raises(
        LabelError, match=r"cannot be read as segments.*has nothing to rebuild it from\. Restore the file"
    ):
        labels.open(b"\0" * 50, b"junk")
    assert labels.parquet.read_bytes() == b"junk"
    assert labels.history.read_bytes() == b"\0" * 50


def test_files_of_a_later_schema_are_refused_and_left_alone(labels: Labels) -> None:
    table = pq.ParquetFile(labels.parquet).read()
    about = table.schema.metadata[b"jiti"].replace(b'"schema_version": 1', b'"schema_version": 9')
    pq.write_table(table.replace_schema_metadata({b"jiti": about}), labels.parquet)
    newer = labels.parquet.read_bytes()
    with pytest.raises(NewerSchema, match=r"ep\.parquet has schema version 9; jiti .* reads versions up to 1. Update"):
        labels.open()
    assert labels.parquet.read_bytes() == newer


def test_a_full_disk_refuses_the_edit_and_keeps_the_rest(labels: Labels) -> None:
    partition = labels.open()
    row = segment(200, 224)
    size = len(labels.histories[-1])
    for limit in (size, size + 1, size + 100):
        with (
            full_disk(limit),
            pytest.raises(SaveFailed, match=r"ep\.jsonl could not be saved: file too large.*Nothing"),
        ):
            partition.apply("mark", [row], based_on=6)
        assert partition.view == labels.views[-1]
        assert labels.history.read_bytes() == labels.histories[-1]
        assert labels.parquet.read_bytes() == labels.parquets[-1]
    partition.apply("mark", [row], based_on=6)
    assert labels.open().segments == partition.segments


def test_a_parquet_file_that_cannot_be_written_takes_the_edit_back(labels: Labels) -> None:
    partition = labels.open()
    obstacle = labels.parquet.with_name(".ep.parquet.tmp")
    obstacle.mkdir()
    for _ in range(2):
        with pytest.raises(SaveFailed, match=r"ep\.parquet could not be saved: is a directory"):
            partition.apply("mark", [segment(200, 224)], based_on=6)
        assert partition.view == labels.views[-1]
        assert labels.history.read_bytes() == labels.histories[-1]
    assert labels.open().view == labels.views[-1]
    obstacle.rmdir()
    partition.apply("mark", [segment(200, 224)], based_on=6)
    assert labels.open().view == partition.view


def test_a_read_only_disk_shows_the_labels_and_refuses_edits() -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        labels = Labels(Path(name) / "labels")
        labels.parquet.write_bytes(labels.parquets[2])
        for path in (labels.folder, *labels.folder.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        with ordinary_user():
            partition = labels.open()
            assert partition.segments == labels.views[-1].segments
            assert [problem.severity for problem in partition.problems] == ["warning", "error"]
            assert "permission denied" in partition.problems[1].remedy
            with pytest.raises(SaveFailed, match=r"ep\.jsonl could not be saved: permission denied.*--labels"):
                partition.apply("mark", [segment(200, 224)], based_on=6)
            assert partition.segments == labels.views[-1].segments
            empty = Partition(labels.folder, "bob", "ep", RECORDING)
            with pytest.raises(SaveFailed, match="annotator=bob could not be saved: permission denied"):
                empty.apply("mark", [segment()], based_on=0)
        for path in (labels.folder, *labels.folder.rglob("*")):
            path.chmod(0o755)
        assert labels.parquet.read_bytes() == labels.parquets[2]
        partition.apply("mark", [segment(200, 224)], based_on=6)
        assert labels.open().segments == partition.segments


def test_files_that_may_not_be_read_are_named(labels: Labels) -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        folder = Path(shutil.copytree(labels.folder, Path(name) / "labels"))
        (folder / "segments" / "annotator=anna" / "ep.parquet").chmod(0)
        with ordinary_user(), pytest.raises(LabelError, match=r"ep\.parquet cannot be opened: permission denied"):
            Partition(folder, "anna", "ep", RECORDING)
        (folder / "history" / "annotator=anna").chmod(0)
        with ordinary_user(), pytest.raises(LabelError, match=r"ep\.jsonl cannot be opened: permission denied"):
            Partition(folder, "anna", "ep", RECORDING)
        assert names_in(folder / "segments" / "annotator=anna") == ["ep.parquet"]
