"""Observations by batches: as LeRobotDataset gives them, without it where no picture is asked for, never stale."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.critic.dataset import dataset_fingerprint, instructions, read_elegant
from jiti.critic.features import rows
from jiti.critic.features.rows import observations
from jiti.errors import SourceError
from tests.critic.with_pictures import FRONT, STATE, elegant_with_pictures


def test_an_instruction_is_served_without_lerobot(toy, monkeypatch):
    monkeypatch.setattr(rows, "_items", None)
    data = read_elegant(toy)
    batches = list(observations(toy, data.fingerprint, (STATE, "task"), 70, 90, 8))
    assert [len(batch["task"]) for batch in batches] == [len(batch[STATE]) for batch in batches] == [8, 8, 4]
    said = [text for batch in batches for text in batch["task"]]
    assert said == [f"do {data.task[episode]}" for episode in data.episode_of[70:90]]
    assert len(set(said)) == 2
    (alone,) = observations(toy, data.fingerprint, ("task",), 0, 4, 8)
    assert alone == {"task": said[:4]}


@pytest.mark.filterwarnings("ignore")  # lerobot warns of its own dependencies
def test_numbers_and_instructions_are_those_that_lerobot_gives(tmp_path):
    root = elegant_with_pictures(tmp_path / "elegant")
    ours = list(observations(root, "ours", (STATE, "task"), 10, 40, 16))
    theirs = list(observations(root, "theirs", (STATE, FRONT, "task"), 10, 40, 16))
    for one, other in zip(ours, theirs, strict=True):
        assert one.keys() == {STATE, "task"}
        assert one["task"] == other["task"]
        assert one[STATE].dtype == other[STATE].dtype
        np.testing.assert_array_equal(one[STATE], other[STATE])


def test_a_dataset_that_was_made_anew_is_read_anew(toy):
    (before,) = observations(toy, dataset_fingerprint(toy), (STATE,), 0, 4, 8)
    path = toy / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    flat = table[STATE].combine_chunks().flatten().to_numpy() + 1
    other = pa.FixedSizeListArray.from_arrays(pa.array(flat), 3)
    pq.write_table(table.set_column(table.column_names.index(STATE), STATE, other), path)
    (after,) = observations(toy, dataset_fingerprint(toy), (STATE,), 0, 4, 8)
    np.testing.assert_allclose(after[STATE], before[STATE] + 1, rtol=1e-6)


def test_a_task_without_an_instruction_is_named(toy):
    pq.write_table(pa.table({"task_index": [0], "task": ["do it"]}), toy / "meta/tasks.parquet")
    with pytest.raises(SourceError, match=r"tasks\.parquet lacks task 1"):
        instructions(toy)
