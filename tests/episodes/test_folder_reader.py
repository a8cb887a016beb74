"""A folder of MCAP files: what is listed, what is remembered, what a bad file does."""

import json
import os
import shutil
import tempfile
import time
from pathlib import Path

import platformdirs
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.episodes.folder_reader import FolderReader, natural_key
from jiti.episodes.mcap_reader import McapReader
from jiti.errors import SourceError
from tests.builders.labels import ordinary_user
from tests.builders.lerobot import write_v3
from tests.builders.mcap import Camera, write_mcap

CAMERA = {"/camera": Camera(width=64, height=48, rate_hz=10.0)}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return platformdirs.user_cache_path("jiti") / "summaries"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("one") / "pick.mcap"
    write_mcap(path, cameras=CAMERA, duration_s=1.0, instruction="Pick up the red cup.")
    return path


@pytest.fixture
def folder(recording: Path, tmp_path: Path) -> Path:
    root = tmp_path / "demos"
    for name in ("pick10.mcap", "pick2.mcap", "day 2/a.mcap", "day 10/a.mcap", ".trash/b.mcap", "labels/c.mcap"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(recording, root / name)
    (root / "notes.txt").write_text("nothing")
    (root / "x.labels").mkdir()
    shutil.copy(recording, root / "x.labels" / "d.mcap")
    return root


def test_recordings_are_listed_in_natural_order(folder: Path) -> None:
    reader = FolderReader(folder)
    assert [ref.title for ref in reader.episodes()] == ["day 2/a.mcap", "day 10/a.mcap", "pick2.mcap", "pick10.mcap"]
    assert [ref.episode_id for ref in reader.episodes()] == ["day%202%2Fa", "day%2010%2Fa", "pick2", "pick10"]
    assert reader.title == "4 recordings in demos"
    assert reader.labels_dir == str(folder / "labels")
    assert all(ref.size_bytes and ref.problem is None and ref.frame_count is None for ref in reader.episodes())


def test_episodes_have_the_ids_of_the_listing_and_of_the_file_alone(folder: Path) -> None:
    reader = FolderReader(folder)
    for ref in reader.episodes():
        episode = reader.open(ref.episode_id)
        assert episode.episode_id == ref.episode_id
        assert episode.clock.frame_count == 10
    alone = McapReader(folder / "pick2.mcap")
    assert alone.episodes()[0].episode_id == "pick2"
    assert alone.labels_dir == reader.labels_dir
    assert alone.open("pick2").fingerprint == reader.open("pick2").fingerprint


def test_an_unknown_episode_is_answered_with_those_that_are_there(folder: Path) -> None:
    with pytest.raises(SourceError) as caught:
        FolderReader(folder).open("pick3")
    assert str(caught.value) == (
        f"{folder} has no recording 'pick3'; it has 4: day%202%2Fa, day%2010%2Fa, pick2, pick10."
    )


def test_bad_files_do_not_stop_the_others(folder: Path) -> None:
    (folder / "bad0.mcap").write_bytes(b"")
    (folder / "bad1.mcap").write_bytes(b"hello, this is no recording")
    (folder / "bad2.mcap").write_bytes((folder / "pick2.mcap").read_bytes()[:9])
    reader = FolderReader(folder)
    problems = {ref.title: ref.problem for ref in reader.episodes()}
    assert "bad0.mcap: it is empty" in str(problems["bad0.mcap"])
    assert "bad1.mcap: it does not start like an MCAP file" in str(problems["bad1.mcap"])
    with pytest.raises(SourceError):
        reader.open("bad1")
    with pytest.raises(SourceError) as caught:
        reader.open("bad2")
    assert reader.open("pick10").clock.frame_count == 10

    # What opening has shown, the next listing knows.
    problems = {ref.title: ref.problem for ref in FolderReader(folder).episodes()}
    assert str(caught.value).rstrip(".") in str(problems["bad2.mcap"])
    assert problems["pick10.mcap"] is None


def test_a_recording_that_is_gone(folder: Path) -> None:
    reader = FolderReader(folder)
    (folder / "pick2.mcap").unlink()
    with pytest.raises(SourceError, match=r"pick2\.mcap: cannot be opened \(No such file or directory\)"):
        reader.open("pick2")


def test_a_folder_that_may_not_be_read(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as parent:
        root = Path(shutil.copytree(folder, Path(parent) / "demos"))
        Path(parent).chmod(0o755)
        (root / "day 2").chmod(0)
        with ordinary_user():
            reader = FolderReader(root)
        (root / "day 2").chmod(0o755)
    assert [ref.title for ref in reader.episodes()] == ["day 10/a.mcap", "pick2.mcap", "pick10.mcap"]
    assert "the folder cannot be read (Permission denied)" in str(reader.problems[0])


# Nothing there


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ([], "found nothing."),
        (["a.bag", "b.bag", "c.txt", "Makefile"], "found 2 .bag, 1 .txt, 1 no suffix."),
        (["meta/stats.json", "data/x.parquet"], "found meta/ and data/ without meta/info.json"),
    ],
)
def test_a_folder_without_recordings_says_what_it_looked_for(tmp_path: Path, names: list[str], found: str) -> None:
    root = tmp_path / "demos"
    root.mkdir()
    for name in names:
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text("x")
    with pytest.raises(SourceError) as caught:
        FolderReader(root)
    assert "Looked for MCAP files (*.mcap) here and below, and for a LeRobot dataset (meta/info.json)" in str(
        caught.value
    )
    assert found in str(caught.value)


def test_a_folder_of_datasets_names_them(tmp_path: Path) -> None:
    write_v3(tmp_path / "all" / "one", (2,))
    write_v3(tmp_path / "all" / "user" / "two", (2,))
    with pytest.raises(SourceError, match=r"found LeRobot datasets in one, user/two\. Open one of them"):
        FolderReader(tmp_path / "all")


def test_a_folder_of_bad_files_shows_the_first(tmp_path: Path) -> None:
    (tmp_path / "demos").mkdir()
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / "demos" / name).write_bytes(b"")
    with pytest.raises(SourceError, match=r"It has 2 MCAP files; the first: a\.mcap: it is empty"):
        FolderReader(tmp_path / "demos")


# The cache


def test_what_was_opened_is_known_without_opening(folder: Path) -> None:
    reader = FolderReader(folder)
    reader.open("pick2")
    assert (reader.episodes()[2].frame_count, reader.episodes()[2].task) == (10, "Pick up the red cup.")
    later = FolderReader(folder).episodes()
    assert [ref.frame_count for ref in later] == [None, None, 10, None]
    assert later[2].task == "Pick up the red cup."


def test_a_recording_that_changed_is_not_known(folder: Path) -> None:
    FolderReader(folder).open("pick2")
    os.utime(folder / "pick2.mcap", ns=(1, 1))
    assert FolderReader(folder).episodes()[2].frame_count is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b'{"version": 1}',
        b'{"version": 99, "recordings": {}}',
        b'{"version": 1, "recordings": {"pick2.mcap": {}}}',
        b'{"version": 1, "recordings": {"pick2.mcap": {"size_bytes": 1, "changed_ns": 2, "frame_count": "many"}}}',
        b'{"version": 1, "recordings": {"pick2.mcap": {"size_bytes": 1, "changed_ns": 2, "problem": ["x"]}}}',
        b"\xff\x00" * 50,
        b"[" * 50_000,
    ],
)
def test_a_damaged_cache_is_as_good_as_none(folder: Path, cache: Path, content: bytes) -> None:
    FolderReader(folder).open("pick2")
    (path,) = cache.iterdir()
    path.write_bytes(content)
    reader = FolderReader(folder)
    assert [ref.frame_count for ref in reader.episodes()] == [None] * 4
    reader.open("pick10")
    assert [ref.frame_count for ref in FolderReader(folder).episodes()] == [None, None, None, 10]
    assert json.loads(path.read_bytes())["version"] == 1


def test_a_cache_that_cannot_be_written_is_no_error(folder: Path, cache: Path) -> None:
    cache.parent.mkdir(parents=True)
    cache.write_text("a file where the folder should be")
    reader = FolderReader(folder)
    assert reader.open("pick2").clock.frame_count == 10
    assert FolderReader(folder).episodes()[2].frame_count is None


def test_two_programs_keep_what_each_has_learnt(folder: Path) -> None:
    one, other = FolderReader(folder), FolderReader(folder)
    one.open("pick2")
    other.open("pick10")
    assert [ref.frame_count for ref in FolderReader(folder).episodes()] == [None, None, 10, 10]


def test_three_hundred_recordings_are_listed_quickly(recording: Path, tmp_path: Path) -> None:
    root = tmp_path / "many"
    root.mkdir()
    for k in range(300):
        os.link(recording, root / f"pick{k}.mcap")
    elapsed_s = []
    for _ in range(3):  # The machine may be busy with something else for one of them.
        started = time.perf_counter()
        refs = FolderReader(root).episodes()
        elapsed_s.append(time.perf_counter() - started)
        assert [ref.title for ref in refs] == [f"pick{k}.mcap" for k in range(300)]
    assert min(elapsed_s) < 0.5


@given(st.lists(st.tuples(st.text("ab/.", max_size=3), st.integers(0, 200), st.text("a1.", max_size=2)), max_size=8))
def test_numbers_in_names_are_ordered_as_numbers(names: list[tuple[str, int, str]]) -> None:
    for head, number, tail in names:
        smaller, larger = f"{head}x{number}y{tail}", f"{head}x{number + 1}y{tail}"
        assert natural_key(smaller) < natural_key(larger)


def test_rollouts_are_no_demonstrations_unless_they_are_opened_themselves(folder: Path) -> None:
    (folder / "day 2" / "plan.json").write_text('{\n  "format": "jiti rollout",\n  "runs": []\n}')
    (folder / "day 10" / "plan.json").write_text('{"format": "someone else\'s"}')
    assert [ref.title for ref in FolderReader(folder).episodes()] == ["day 10/a.mcap", "pick2.mcap", "pick10.mcap"]
    assert [ref.title for ref in FolderReader(folder / "day 2").episodes()] == ["a.mcap"]
    for path in (folder / "day 10" / "a.mcap", folder / "pick2.mcap", folder / "pick10.mcap"):
        path.unlink()
    with pytest.raises(SourceError, match="found rollouts in day 2"):
        FolderReader(folder)
