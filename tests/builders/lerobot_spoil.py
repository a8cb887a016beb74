"""Spoil the dataset of the fixture `root`, and see what is said of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa

from jiti.episodes.lerobot_reader import LeRobotEpisode, LeRobotReader
from tests.builders.lerobot import FRONT, episode_table, write_tables

DATA = "data/chunk-000/file-000.parquet"
VIDEO = f"videos/{FRONT}/chunk-000/file-000.mp4"
FIRST = "episode_000000"


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
