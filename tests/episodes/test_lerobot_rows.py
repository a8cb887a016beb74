"""Rows that are not what the dataset says: what is said, and what is still read."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.episodes.episode import ImageBatch, numbers
from jiti.episodes.lerobot_reader import LeRobotEpisode, LeRobotReader
from jiti.episodes.lerobot_rows import to_floats
from jiti.errors import SourceError
from tests.builders.lerobot import (
    FRONT,
    IMAGES,
    WRIST,
    episode_table,
    write_tables,
    write_v3,
)
from tests.builders.lerobot_spoil import DATA, FIRST, change_rows, said, with_column


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


@given(
    rows=st.lists(
        st.none() | st.lists(st.none() | st.lists(st.none() | st.floats(-9, 9, width=32), max_size=3), max_size=3),
        min_size=1,
        max_size=5,
    ),
    size=st.integers(1, 6),
)
def test_nested_lists_never_slip_from_one_row_into_the_next(rows: list[Any], size: int) -> None:
    values = to_floats(pa.array(rows, pa.list_(pa.list_(pa.float32()))), size)
    for row, value in zip(rows, values, strict=True):
        flat = [x for part in (row or []) for x in ([None] if part is None else part)][:size]
        padded = [np.nan if x is None else x for x in flat] + [np.nan] * (size - len(flat))
        assert np.array_equal(value, padded, equal_nan=True)
