"""The one place that chooses a reader."""

import shutil
from pathlib import Path

import pytest

from jiti.episodes.folder_reader import FolderReader
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.mcap_reader import McapReader
from jiti.episodes.reader import FORMATS, open_reader
from jiti.errors import SourceError
from tests.builders.lerobot import write_v3, write_v21
from tests.builders.mcap import Camera, write_mcap


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with caches of its own and no network."""
    for name in ("HF_HOME", "HF_LEROBOT_HOME", "HF_HUB_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "caches" / name))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def write_recording(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_mcap(path, cameras={"/camera": Camera(width=64, height=48, rate_hz=10.0)}, duration_s=0.5)
    return path


def test_one_file(here: Path) -> None:
    write_recording(here / "pick.mcap")
    reader = open_reader("pick.mcap")
    assert isinstance(reader, McapReader)
    assert Path(reader.labels_dir) == here / "labels"


def test_a_file_is_known_by_its_first_bytes(here: Path) -> None:
    write_recording(here / "a.mcap").rename(here / "recording.bin")
    assert isinstance(open_reader(here / "recording.bin"), McapReader)


def test_a_folder_and_the_current_one(here: Path) -> None:
    write_recording(here / "demos" / "pick.mcap")
    for reader in (open_reader("demos"), open_reader()):
        assert isinstance(reader, FolderReader)
    assert open_reader("demos").labels_dir == str(here / "demos" / "labels")


@pytest.mark.parametrize("write", [write_v3, write_v21])
def test_a_dataset_folder(here: Path, write: object) -> None:
    root = write(here / "cups", (2, 3))  # type: ignore[operator]
    write_recording(root / "pick.mcap")
    reader = open_reader("cups")
    assert isinstance(reader, LeRobotReader)
    assert reader.labels_dir == str(here / "cups" / "meta" / "jiti")


def test_a_path_in_the_home_folder(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(here))
    write_recording(here / "pick.mcap")
    assert isinstance(open_reader("~/pick.mcap"), McapReader)


def test_the_same_episode_has_one_id_and_one_place_for_labels(here: Path) -> None:
    write_recording(here / "pick.mcap")
    alone, folder = open_reader("pick.mcap"), open_reader(".")
    assert alone.episodes()[0].episode_id == folder.episodes()[0].episode_id
    assert Path(alone.labels_dir).resolve() == Path(folder.labels_dir).resolve()


def test_a_path_comes_before_an_id_on_the_hub(here: Path) -> None:
    write_v3(here / "user" / "name", (2,))
    write_v3(here.parent / "caches" / "HF_LEROBOT_HOME" / "user" / "name", (2, 3, 4))
    assert len(open_reader("user/name").episodes()) == 1
    shutil.rmtree(here / "user")
    reader = open_reader("user/name")
    assert len(reader.episodes()) == 3
    assert reader.title == "3 episodes in user/name"
    assert reader.labels_dir == str(here / "name.labels")


@pytest.mark.parametrize("name", ["nothing", "nothing.mcap", "demos/nothing.mcap", "/nowhere/at/all", "a/b/c"])
def test_what_is_not_there_names_the_formats(here: Path, name: str) -> None:
    with pytest.raises(SourceError) as caught:
        open_reader(name)
    assert str(caught.value).startswith(f"{name}: no such file or folder. Give ")
    assert all(known in str(caught.value) for known in FORMATS)


def test_a_file_of_another_kind_names_the_formats(here: Path) -> None:
    (here / "notes.txt").write_text("nothing")
    with pytest.raises(SourceError, match=r"notes\.txt is not a recording that jiti can read\. Give an MCAP file"):
        open_reader("notes.txt")


def test_a_part_of_a_dataset_names_the_dataset(here: Path) -> None:
    root = write_v3(here / "cups", (2,))
    with pytest.raises(SourceError, match=r"file-000\.parquet is a part of the LeRobot dataset in .*cups\. Open that"):
        open_reader(root / "data/chunk-000/file-000.parquet")


def test_a_typing_error_in_a_folder_that_exists_does_not_ask_the_hub(here: Path) -> None:
    write_recording(here / "demos" / "pick.mcap")
    with pytest.raises(SourceError, match="demos/pikc: no such file or folder"):
        open_reader("demos/pikc")
