"""Videos and pictures that are missing, short, long or damaged: what is said, and what is still shown."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.episodes.lerobot_reader import LeRobotReader
from tests.builders.lerobot import (
    FRONT,
    IMAGES,
    WRIST,
    read_episodes,
    read_info,
    write_episodes,
    write_info,
    write_tables,
    write_v3,
)
from tests.builders.lerobot_spoil import DATA, FIRST, VIDEO, said


def test_a_missing_video_is_a_problem_and_the_rest_opens(root: Path) -> None:
    (root / VIDEO).unlink()
    episode = LeRobotReader(root).open(FIRST)
    assert said(episode) == (
        f"demo/{VIDEO}: the video is missing or cannot be opened (No such file or directory). Download the dataset's "
        f"videos again, or go on without this camera. {FRONT} is not shown; the other streams are."
    )
    assert list(episode.streams) == ["observation.state", "action", WRIST, "next.reward"]
    assert episode.clock.reference == WRIST
    assert {b.stream for b in episode.read()} == set(episode.streams)


def test_a_video_that_was_cut_off_in_its_index(root: Path) -> None:
    (root / VIDEO).write_bytes((root / VIDEO).read_bytes()[:200])
    episode = LeRobotReader(root).open(FIRST)
    assert "the video cannot be opened" in said(episode)
    assert FRONT not in episode.streams


def test_a_video_that_was_cut_off_in_its_pictures(root: Path) -> None:
    content = (root / VIDEO).read_bytes()
    (root / VIDEO).write_bytes(content[:-200])
    reader = LeRobotReader(root)
    assert reader.open(FIRST).problems == []
    last = reader.open("episode_000002")
    (problem,) = last.problems
    assert problem.severity == "error"
    assert "of 15 frames have a picture; the first without one is frame" in problem.what
    assert last.clock.frame_count == 15
    count = last.streams[FRONT].count
    assert 0 < count < 15
    times = np.concatenate([b.time_ns for b in last.read([FRONT])])
    assert times.tolist() == last.clock.frame_ns[:count].tolist()


def test_an_episode_without_a_place_in_any_video(root: Path) -> None:
    rows = read_episodes(root)
    rows[0][f"videos/{FRONT}/from_timestamp"] = float("nan")
    write_episodes(root, rows)
    episode = LeRobotReader(root).open(FIRST)
    assert f"episode 0: does not say where the video of '{FRONT}' is" in said(episode)
    assert WRIST in episode.streams


def test_a_part_of_video_that_is_longer_than_the_rows(root: Path) -> None:
    rows = read_episodes(root)
    rows[2][f"videos/{FRONT}/to_timestamp"] += 1.0
    write_episodes(root, rows)
    assert "the video has 45 frames for episode 2, the episode has 15 rows" in said(
        LeRobotReader(root).open("episode_000002")
    )


def test_a_part_of_video_beyond_the_file(root: Path) -> None:
    rows = read_episodes(root)
    for name in ("from_timestamp", "to_timestamp"):
        rows[2][f"videos/{FRONT}/{name}"] += 0.2
    write_episodes(root, rows)
    episode = LeRobotReader(root).open("episode_000002")
    assert "9 of 15 frames have a picture; the first without one is frame 9" in said(episode)


def test_a_video_of_another_rate_is_reported(root: Path) -> None:
    write_info(root, read_info(root) | {"fps": 60})
    message = said(LeRobotReader(root).open(FIRST))
    assert "the dataset says 60 Hz, the video runs at 30 Hz" in message
    assert "timestamps run at 30 Hz; info.json says 60 Hz" in message


def test_a_column_of_pictures_with_some_that_are_none(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "demo", (6,), encoder=IMAGES)
    table = pq.read_table(root / DATA)
    cells = table[FRONT].to_pylist()
    cells[1] = {"bytes": b"not a picture", "path": None}
    cells[2] = {"bytes": None, "path": "../../etc/passwd"}
    cells[4] = None
    at = table.column_names.index(FRONT)
    write_tables(root / DATA, [table.set_column(at, FRONT, pa.array(cells, table.schema.field(FRONT).type))])
    episode = LeRobotReader(root).open(FIRST)
    times = np.concatenate([b.time_ns for b in episode.read([FRONT])])
    assert times.tolist() == episode.clock.frame_ns[[0, 3, 5]].tolist()
    assert "3 of 6 frames have no JPEG or PNG picture, the first is frame 1" in said(episode)
    list(episode.read([FRONT]))
    assert len(episode.problems) == 1
