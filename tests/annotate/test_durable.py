"""Files are there in whole or not at all."""

import tempfile
from pathlib import Path

import pytest

from jiti.durable import make_folder, replacing, write_atomic
from jiti.errors import SaveFailed
from tests.builders.labels import full_disk, names_in, ordinary_user


@pytest.mark.parametrize("locked", [False, True])
def test_replaces_and_leaves_nothing_else(tmp_path: Path, *, locked: bool) -> None:
    path = tmp_path / "a.bin"
    for data in (b"", b"one", b"two" * 100_000):
        write_atomic(path, data, locked=locked)
        assert path.read_bytes() == data
    assert names_in(tmp_path) == ["a.bin"]


def test_temporary_file_of_a_killed_process_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / ".a.bin.tmp").write_bytes(b"half of a longer file that a killed process left")
    write_atomic(tmp_path / "a.bin", b"new", locked=True)
    assert names_in(tmp_path) == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"new"


@pytest.mark.parametrize("locked", [False, True])
def test_full_disk_keeps_the_old_file(tmp_path: Path, *, locked: bool) -> None:
    path = tmp_path / "a.bin"
    write_atomic(path, b"old", locked=locked)
    with full_disk(1000), pytest.raises(SaveFailed, match=r"a\.bin could not be saved: .*Nothing .* lost.*Free some"):
        write_atomic(path, b"x" * 5000, locked=locked)
    assert path.read_bytes() == b"old"
    assert names_in(tmp_path) == ["a.bin"]


def test_read_only_folder_says_so() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o555)
        with ordinary_user():
            with pytest.raises(SaveFailed, match=r"a\.bin could not be saved: permission denied.*--labels"):
                write_atomic(folder / "a.bin", b"data")
            with pytest.raises(SaveFailed, match="deep could not be saved: permission denied"):
                make_folder(folder / "labels" / "deep")
        folder.chmod(0o700)


def test_replacing_takes_the_place_only_after_the_block(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    path.write_bytes(b"old")
    with replacing(path) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.name.startswith(".")
        assert temporary.suffix == ".parquet"
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    with pytest.raises(UnicodeEncodeError), replacing(path) as temporary:
        temporary.write_text("newer, then \ud800", encoding="utf-8")
    with full_disk(1000), pytest.raises(SaveFailed, match=r"a\.parquet"), replacing(path) as temporary:
        temporary.write_bytes(b"x" * 5000)
    assert path.read_bytes() == b"new"
    assert names_in(tmp_path) == ["a.parquet"]


def test_make_folder_makes_parents_and_knows_existing_ones(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b" / "c")
    make_folder(tmp_path / "a" / "b" / "c")
    assert (tmp_path / "a" / "b" / "c").is_dir()
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(SaveFailed, match="file"):
        make_folder(tmp_path / "file")
    with pytest.raises(SaveFailed, match="inner could not be saved: not a directory"):
        make_folder(tmp_path / "file" / "inner")
