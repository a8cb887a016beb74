"""What is wrong in a table of contents: what is said, and what is still listed."""

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.episodes.lerobot_info import load_info
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.lerobot_v3 import read_tasks_v3
from jiti.errors import SourceError
from tests.builders.lerobot import (
    FRONT,
    read_episodes,
    read_info,
    write_episodes,
    write_info,
    write_v21,
)
from tests.builders.lerobot_spoil import FIRST, VIDEO, said


def test_a_missing_table_says_what_to_download(root: Path) -> None:
    shutil.rmtree(root / "meta/episodes")
    with pytest.raises(SourceError, match="demo/meta/episodes: there is no episode table"):
        LeRobotReader(root)


def test_a_table_without_its_columns_names_the_first(root: Path) -> None:
    write_episodes(root, [{"episode": 0}])
    with pytest.raises(SourceError, match=r"file-000\.parquet: has no column 'episode_index'; it has episode"):
        LeRobotReader(root)


def test_a_bad_file_of_the_table_leaves_the_others(root: Path) -> None:
    (root / "meta/episodes/chunk-000/file-001.parquet").write_bytes(b"PAR1 never finalized")
    reader = LeRobotReader(root)
    assert len(reader.episodes()) == 3
    assert "file-001.parquet: the file has no footer (20 bytes)" in str(reader.problems[0])


def test_the_counts_must_agree(root: Path) -> None:
    write_info(root, read_info(root) | {"total_episodes": 7})
    (problem,) = LeRobotReader(root).problems
    assert str(problem) == (
        "demo/meta/episodes: 3 episodes are listed; info.json says 7. The list is used; correct total_episodes."
    )


def test_an_episode_that_is_listed_twice_is_shown_once(root: Path) -> None:
    rows = read_episodes(root)
    rows[2]["episode_index"] = 1
    write_episodes(root, rows)
    reader = LeRobotReader(root)
    assert [ref.episode_id for ref in reader.episodes()] == ["episode_000000", "episode_000001"]
    assert "episode 1 is listed twice" in str(reader.problems[0])
    assert reader.open("episode_000001").clock.frame_count == 9


@pytest.mark.parametrize("length", [0, -4, None])
def test_an_empty_episode_is_listed_with_its_problem(root: Path, length: int | None) -> None:
    rows = read_episodes(root)
    rows[1]["length"] = length
    write_episodes(root, rows)
    reader = LeRobotReader(root)
    refs = reader.episodes()
    assert [bool(ref.problem) for ref in refs] == [False, True, False]
    with pytest.raises(SourceError, match="demo/meta/episodes, episode 1: the episode has no frames"):
        reader.open("episode_000001")
    assert reader.open("episode_000002").problems == []


@pytest.mark.parametrize("episode_id", ["episode_000003", "episode_3", "../x", "", "episode_0000000", "pick"])
def test_an_unknown_episode_is_answered_with_those_that_are_there(root: Path, episode_id: str) -> None:
    with pytest.raises(SourceError) as caught:
        LeRobotReader(root).open(episode_id)
    assert str(caught.value) == (f"demo has no episode {episode_id!r}; it has 3: episode_000000 to episode_000002.")


def test_rows_that_two_episodes_claim(root: Path) -> None:
    rows = read_episodes(root)
    rows[1]["dataset_from_index"] = 10
    write_episodes(root, rows)
    assert "rows 0 to 11 is claimed by episode 1 too" in said(LeRobotReader(root).open(FIRST))


def test_pictures_that_two_episodes_claim(root: Path) -> None:
    rows = read_episodes(root)
    rows[1][f"videos/{FRONT}/from_timestamp"] = 11 / 30
    write_episodes(root, rows)
    reader = LeRobotReader(root)
    assert f"the part of {VIDEO} from 0.367 s is claimed by episode 0 too" in said(reader.open("episode_000001"))
    assert f"the part of {VIDEO} from 0.000 s is claimed by episode 1 too" in said(reader.open(FIRST))
    assert reader.open("episode_000002").problems == []


def test_v21_that_lacks_its_parts(tmp_path: Path) -> None:
    root = write_v21(tmp_path / "demo", (12, 9))
    (root / f"videos/chunk-000/{FRONT}/episode_000000.mp4").unlink()
    (root / "data/chunk-000/episode_000001.parquet").unlink()
    reader = LeRobotReader(root)
    first, second = (reader.open(ref.episode_id) for ref in reader.episodes())
    assert "episode_000000.mp4: the video is missing" in said(first)
    assert "episode_000001.parquet: the file is missing" in said(second)
    assert list(second.streams) == [FRONT]
    (root / "meta/episodes.jsonl").unlink()
    with pytest.raises(SourceError, match=r"demo/meta/episodes\.jsonl: cannot be read \(No such file or directory\)"):
        LeRobotReader(root)


def test_v21_with_bad_lines(tmp_path: Path) -> None:
    root = write_v21(tmp_path / "demo", (12, 9))
    path = root / "meta/episodes.jsonl"
    path.write_text("{broken\n[1]\n\n" + path.read_text() + json.dumps({"episode_index": 7}) + "\n")
    reader = LeRobotReader(root)
    assert [ref.frame_count for ref in reader.episodes()] == [12, 9]
    assert [problem.where for problem in reader.problems] == [
        f"demo/meta/episodes.jsonl, line {line}" for line in (1, 2, 6)
    ]


def test_a_v21_video_that_goes_on_after_the_rows(tmp_path: Path) -> None:
    root = write_v21(tmp_path / "demo", (12, 9))
    videos = root / f"videos/chunk-000/{FRONT}"
    shutil.copy(videos / "episode_000000.mp4", videos / "episode_000001.mp4")
    episode = LeRobotReader(root).open("episode_000001")
    assert "the video has 12 frames for episode 1, the episode has 9 rows" in said(episode)
    assert episode.streams[FRONT].count == 9


def test_an_instruction_that_is_no_text_is_damage(root: Path) -> None:
    path = root / "meta/tasks.parquet"
    table = pq.read_table(path)
    texts = (pa.string(), pa.large_string())
    place = next(n for n in table.column_names if table.schema.field(n).type in texts)
    bad = pa.array([b"\xff\xfe"] * len(table), pa.binary()).view(pa.string())
    pq.write_table(table.set_column(table.column_names.index(place), place, bad).replace_schema_metadata(), path)
    with pytest.raises(SourceError, match=r"tasks\.parquet: the file is damaged"):
        read_tasks_v3(load_info(root))
