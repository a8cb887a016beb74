"""LeRobot datasets with something wrong: what is said, and what still opens."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.episodes.episode import ImageBatch, numbers
from jiti.episodes.lerobot_info import load_info
from jiti.episodes.lerobot_reader import LeRobotEpisode, LeRobotReader
from jiti.episodes.lerobot_rows import to_floats
from jiti.errors import SourceError
from tests.builders.lerobot import (
    FRONT,
    IMAGES,
    WRIST,
    episode_table,
    read_episodes,
    read_info,
    write_episodes,
    write_info,
    write_tables,
    write_v3,
    write_v21,
)

DATA = "data/chunk-000/file-000.parquet"
VIDEO = f"videos/{FRONT}/chunk-000/file-000.mp4"
FIRST = "episode_000000"


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_v3(tmp_path_factory.mktemp("good") / "demo", (12, 9, 15), cameras=(FRONT, WRIST))


@pytest.fixture
def root(good: Path, tmp_path: Path) -> Path:
    """A dataset of three episodes with two cameras, to be spoiled."""
    return Path(shutil.copytree(good, tmp_path / "demo"))


def said(episode: LeRobotEpisode) -> str:
    return "\n".join(str(problem) for problem in episode.problems)


def change_rows(root: Path, change: Callable[[pa.Table], pa.Table], length: int = 12) -> LeRobotEpisode:
    """Replace the rows of the first episode, and open it."""
    tables = [
        change(episode_table(0, length, 0, 0, 30)),
        episode_table(1, 9, 12, 0, 30),
        episode_table(2, 15, 21, 0, 30),
    ]
    write_tables(root / DATA, tables)
    return LeRobotReader(root).open(FIRST)


def with_column(name: str, values: Any) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        at = table.column_names.index(name)
        return table.set_column(at, name, pa.array(values, table.schema.field(name).type))

    return change


# info.json


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "demo/meta/info.json: is not JSON (Expecting property name enclosed in double quotes"),
        (b"[" * 100_000, "demo/meta/info.json: is not JSON"),
        (b"\xff\xfe\x00", "demo/meta/info.json: is not JSON"),
        (b"[1]", "demo/meta/info.json: is a JSON list; it must be an object"),
        (b"{}", "demo/meta/info.json: has no 'codebase_version'; it has nothing"),
    ],
)
def test_info_that_is_no_info(root: Path, content: bytes, message: str) -> None:
    (root / "meta/info.json").write_bytes(content)
    with pytest.raises(SourceError) as caught:
        LeRobotReader(root)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": None}, "fps is None; it must be a number above 0"),
        ({"fps": 0}, "fps is 0; it must be a number above 0"),
        ({"fps": -30}, "fps is -30"),
        ({"fps": "30"}, "fps is '30'"),
        ({"fps": float("nan")}, "fps is nan"),
        (
            {"codebase_version": "v1.6"},
            "codebase_version is 'v1.6'; jiti reads v3.0, v2.1 and v2.0. Convert the dataset",
        ),
        ({"codebase_version": "v4.0"}, "codebase_version is 'v4.0'; jiti reads v3.0, v2.1 and v2.0. Update jiti."),
        ({"codebase_version": 3}, "codebase_version is 3"),
        ({"features": []}, "features is list; it must be an object"),
        ({"features": {"action": {"shape": [2]}}}, "feature 'action' has no dtype"),
        ({"features": {"action": {"dtype": "float32", "shape": "two"}}}, "the shape of feature 'action' is 'two'"),
        ({"data_path": 7}, "data_path is 7; it must be a path template"),
    ],
)
def test_info_with_a_wrong_value_names_it(root: Path, change: dict[str, Any], message: str) -> None:
    write_info(root, read_info(root) | change)
    with pytest.raises(SourceError) as caught:
        LeRobotReader(root)
    assert str(caught.value).startswith("demo/meta/info.json: ")
    assert message in str(caught.value)


@pytest.mark.parametrize("key", ["codebase_version", "fps", "features"])
def test_info_that_lacks_a_key_names_it(root: Path, key: str) -> None:
    write_info(root, {k: v for k, v in read_info(root).items() if k != key})
    with pytest.raises(SourceError, match=rf"demo/meta/info\.json: has no '{key}'; it has "):
        LeRobotReader(root)


@pytest.mark.parametrize("key", ["data_path", "video_path"])
@pytest.mark.parametrize(
    "template",
    [
        "../../etc/{chunk_index}",
        "/etc/passwd",
        "~/{chunk_index}",
        "data/../../../x-{file_index:03d}",
        "data//x",
        "data\\..\\..\\x",
        "",
        "x\0y",
    ],
)
def test_paths_never_lead_outside_the_dataset(root: Path, key: str, template: str) -> None:
    write_info(root, read_info(root) | {key: template})
    with pytest.raises(SourceError, match=rf"demo/meta/info\.json: {key} .* not a place inside the dataset"):
        LeRobotReader(root).open(FIRST)


@pytest.mark.parametrize("template", ["data/{chunk_index.__class__}", "data/{chunk_index:99999999d}", "data/{}"])
def test_templates_can_do_nothing_but_fill_in_numbers(root: Path, template: str) -> None:
    write_info(root, read_info(root) | {"data_path": template})
    assert f"demo/{template}: the file is missing" in said(LeRobotReader(root).open(FIRST))


def test_a_template_that_asks_for_something_unknown(root: Path) -> None:
    write_info(root, read_info(root) | {"data_path": "data/{episode_index:06d}"})
    with pytest.raises(SourceError, match="asks for 'episode_index'; known are chunk_index, file_index"):
        LeRobotReader(root).open(FIRST)


def test_a_video_key_cannot_lead_outside(root: Path) -> None:
    info = read_info(root)
    info["features"]["../../x"] = info["features"][FRONT]
    write_info(root, info)
    rows = read_episodes(root)
    for row in rows:
        row |= {k.replace(FRONT, "../../x"): v for k, v in row.items() if FRONT in k}
    write_episodes(root, rows)
    with pytest.raises(SourceError, match="not a place inside the dataset"):
        LeRobotReader(root).open(FIRST)


@settings(deadline=None, max_examples=60)
@given(template=st.text(st.sampled_from("ab/.{}~\\:3d_" + "chunk_index"), max_size=30))
def test_no_template_gives_a_path_outside(template: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    root = tmp_path_factory.mktemp("d") / "demo"
    base = {"codebase_version": "v3.0", "fps": 30, "features": {}}
    write_info(root, base | {"data_path": template})
    try:
        path = load_info(root).data_file(chunk_index=1, file_index=2)
    except SourceError:
        return
    inside = os.path.normpath(root / path)
    assert inside.startswith(f"{root}{os.sep}")


# The table of contents


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


# Data files


def test_without_its_data_file_the_videos_still_open(root: Path) -> None:
    (root / DATA).unlink()
    episode = LeRobotReader(root).open(FIRST)
    assert list(episode.streams) == [FRONT, WRIST]
    assert episode.clock.frame_count == 12
    assert said(episode) == (
        f"demo/{DATA}: the file is missing or cannot be opened (No such file or directory). "
        "Download the dataset again. Only the videos of this episode are shown."
    )
    assert sum(len(b.time_ns) for b in episode.read()) == 24


def test_without_data_and_videos_there_is_nothing_to_open(root: Path) -> None:
    shutil.rmtree(root / "data")
    shutil.rmtree(root / "videos")
    with pytest.raises(SourceError, match=rf"demo/{DATA}: the file is missing"):
        LeRobotReader(root).open(FIRST)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda data: data[:-300], "the file has no footer"),
        (lambda data: b"", "is not a Parquet file"),
        (lambda data: b"hello" * 20, "is not a Parquet file"),
        (lambda data: b"version https://git-lfs.github.com/spec/v1\n", "Run `git lfs pull` in the dataset"),
        (lambda data: data[:-200] + bytes(192) + data[-8:], "is not a Parquet file"),
    ],
)
def test_a_data_file_that_is_none(root: Path, spoil: Callable[[bytes], bytes], message: str) -> None:
    path = root / DATA
    path.write_bytes(spoil(path.read_bytes()))
    episode = LeRobotReader(root).open(FIRST)
    assert message in said(episode)
    assert said(episode).startswith(f"demo/{DATA}: ")
    assert list(episode.streams) == [FRONT, WRIST]


def test_a_file_that_was_never_finalized_names_the_cause(root: Path) -> None:
    path = root / DATA
    path.write_bytes(path.read_bytes()[:-500])
    message = said(LeRobotReader(root).open(FIRST))
    assert "its recorder was killed before it was finalized, or the download was cut off" in message
    assert "the other files stay usable" in message


def test_rows_that_are_not_there(root: Path) -> None:
    write_tables(root / DATA, [episode_table(1, 9, 12, 0, 30)])
    assert "has no row of episode 0" in said(LeRobotReader(root).open(FIRST))


def test_more_and_fewer_rows_than_the_table_of_contents_says(root: Path) -> None:
    episode = change_rows(root, lambda table: table, 10)
    assert "it has 10 rows; the table of contents says 12 frames" in said(episode)
    assert episode.clock.frame_count == 10
    assert episode.streams[FRONT].count == 10


def test_shuffled_rows_are_put_in_order(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "demo", (100,), encoder=IMAGES, size=(64, 48))
    table = pq.read_table(root / DATA)
    order = np.random.default_rng(1).permutation(100)
    write_tables(root / DATA, [table.take(pa.array(order))])
    episode = LeRobotReader(root).open(FIRST)
    assert f"the rows are shuffled: row 0 is frame {order[0]}" in said(episode)
    assert numbers(episode, "observation.state")[1][:, 0].tolist() == list(range(100))
    plain = LeRobotReader(write_v3(tmp_path / "plain", (100,), encoder=IMAGES, size=(64, 48))).open(FIRST)

    def pictures(e: LeRobotEpisode) -> list[tuple[int, bytes]]:
        return [
            sample
            for b in e.read([FRONT])
            if isinstance(b, ImageBatch)
            for sample in zip(b.time_ns.tolist(), b.data, strict=True)
        ]

    assert pictures(episode) == pictures(plain)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0, 1, 2, 3, 4, 5, 5, 7, 8, 9, 10, 11], "frame_index does not count from 0 to 11: row 6 has 5"),
        ([*range(1, 13)], "frame_index does not count from 0 to 11: row 0 has 1"),
        ([0, 1, None, *range(3, 12)], "frame_index does not count from 0 to 11: row 2 has nan"),
    ],
)
def test_frame_numbers_that_do_not_count(root: Path, values: list[int], message: str) -> None:
    assert message in said(change_rows(root, with_column("frame_index", values)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t * 2, "timestamps run at 15 Hz; info.json says 30 Hz"),
        (lambda t: t * 1.001 + np.where(np.arange(12) > 8, 0.01, 0), "from their frames, first at frame 9"),
        (lambda t: np.where(np.arange(12) == 5, np.nan, t), "1 timestamps are not numbers, the first at frame 5"),
        (lambda t: np.where(np.arange(12) == 5, np.inf, t), "1 timestamps are not numbers, the first at frame 5"),
        (lambda t: np.where(np.arange(12) == 5, 0.0, t), "the timestamp goes back at 1 frames, first at frame 5"),
        (lambda t: np.where(np.arange(12) == 5, t[4], t), "the timestamp repeats at 1 frames, first at frame 5"),
        (lambda t: t + 3, "timestamps stand up to 90 frames from their frames, first at frame 0"),
    ],
)
def test_timestamps_are_checked_against_the_clock(
    root: Path, change: Callable[[np.ndarray], np.ndarray], message: str
) -> None:
    episode = change_rows(root, with_column("timestamp", change(np.arange(12) / 30).astype(np.float32)))
    assert message in said(episode)
    assert f"demo/{DATA}, episode 0: " in said(episode)
    assert episode.clock.frame_ns.tolist() == [round(i * 1e9 / 30) for i in range(12)]


def test_the_row_number_is_checked(root: Path) -> None:
    assert "index jumps from 4 to 7 after frame 4" in said(
        change_rows(root, with_column("index", [0, 1, 2, 3, 4, *range(7, 14)]))
    )
    assert "its rows begin at index 50; the table of contents says 0" in said(
        change_rows(root, with_column("index", list(range(50, 62))))
    )


@pytest.mark.parametrize("name", ["timestamp", "frame_index", "action"])
def test_a_missing_column_is_named(root: Path, name: str) -> None:
    tables = [episode_table(e, n, s, 0, 30).drop_columns([name]) for e, n, s in ((0, 12, 0), (1, 9, 12), (2, 15, 21))]
    write_tables(root / DATA, tables)
    episode = LeRobotReader(root).open(FIRST)
    assert f"there is no column '{name}'" in said(episode)
    assert numbers(episode, "observation.state")[1].shape == (12, 3)
    assert "action" in episode.streams or name == "action"


def test_without_the_episode_column_the_rows_cannot_be_told_apart(root: Path) -> None:
    write_tables(root / DATA, [episode_table(0, 12, 0, 0, 30).drop_columns(["episode_index"])])
    assert "has no column 'episode_index'" in said(LeRobotReader(root).open(FIRST))


# Videos


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


# v2.1


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


# Numbers


@given(
    rows=st.lists(st.none() | st.lists(st.none() | st.floats(-1e6, 1e6, width=32), max_size=5), min_size=1, max_size=8),
    size=st.integers(1, 4),
    cut=st.integers(0, 3),
)
def test_lists_of_any_length_become_rows_of_one_size(
    rows: list[list[float | None] | None], size: int, cut: int
) -> None:
    column = pa.array([[9.0]] * cut + rows, pa.list_(pa.float32()))[cut:]
    values = to_floats(column, size)
    assert values.shape == (len(rows), size)
    for row, value in zip(rows, values, strict=True):
        padded = [np.nan if x is None else x for x in (row or [])][:size]
        padded += [np.nan] * (size - len(padded))
        assert np.array_equal(value, np.array(padded), equal_nan=True)


@given(values=st.lists(st.none() | st.integers(-(2**40), 2**40), min_size=1, max_size=20), cut=st.integers(0, 5))
def test_scalars_keep_their_values_and_nulls(values: list[int | None], cut: int) -> None:
    column = pa.array([1] * cut + values, pa.int64())[cut:]
    expected = [np.nan if value is None else float(value) for value in values]
    assert np.array_equal(to_floats(column, 1)[:, 0], expected, equal_nan=True)
