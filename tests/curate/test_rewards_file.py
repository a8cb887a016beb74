"""The derived file: reproducible, in whole or not at all, and with how it was derived."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from jiti.annotate.folder import segments_path
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import Recording
from jiti.curate.rewards_file import REWARDS_SCHEMA, write_rewards
from jiti.curate.verdicts import RULE
from jiti.errors import LabelError, SaveFailed
from tests.builders.labels import full_disk, names_in, segment


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    folder = tmp_path / "labels"
    partition = Partition(folder, "anna", "b", Recording(4, 20.0, "x"))
    partition.apply("mark", [segment(1, 2, 1, episode_id="b")], based_on=0)
    partition = Partition(folder, "anna", "a", Recording(2, 10.0, "y"))
    partition.apply("mark", [row := segment(1, 1, 1, episode_id="a")], based_on=0)
    partition.apply("delete", remove=[row.segment_id], based_on=1)
    return folder


def test_every_frame_of_every_labelled_episode(labels: Path) -> None:
    path = write_rewards(labels, gamma=0.5)
    assert path == labels / "rewards.parquet"
    found = pq.ParquetFile(path).read()
    assert found.schema.remove_metadata() == REWARDS_SCHEMA
    columns = found.to_pydict()
    assert columns["episode_id"] == ["a", "a", "b", "b", "b", "b"]
    assert columns["frame_index"] == [0, 1, 0, 1, 2, 3]
    assert columns["timestamp"] == pytest.approx([0, 0.1, 0, 0.05, 0.1, 0.15])
    assert columns["reward"] == [0, 0, 0, 1, 1, 0]
    assert columns["annotated"] == [False, False, False, True, True, False]
    assert columns["mc_return"] == [0, 0, 0.75, 1.5, 1, 0]
    assert json.loads(found.schema.metadata[b"jiti"]) == {"schema_version": 1, "gamma": 0.5, "rule": RULE}


def test_the_same_labels_give_the_same_bytes(labels: Path) -> None:
    first = write_rewards(labels).read_bytes()
    assert write_rewards(labels).read_bytes() == first
    assert write_rewards(labels, gamma=0.9).read_bytes() != first


def test_no_labels_are_no_rows(tmp_path: Path) -> None:
    assert pq.ParquetFile(write_rewards(tmp_path / "labels")).read().num_rows == 0


def test_a_full_disk_keeps_the_old_file(labels: Path) -> None:
    path = write_rewards(labels)
    before, names = path.read_bytes(), names_in(labels)
    with full_disk(50), pytest.raises(SaveFailed, match=r"rewards\.parquet could not be saved: file too large"):
        write_rewards(labels, gamma=0.1)
    assert path.read_bytes() == before
    assert names_in(labels) == names


def test_labels_that_cannot_be_read_give_no_rewards(labels: Path) -> None:
    segments_path(labels, "anna", "a").write_bytes(b"junk")
    with pytest.raises(LabelError, match=r"a\.parquet cannot be read as segments"):
        write_rewards(labels)
    assert not (labels / "rewards.parquet").exists()
