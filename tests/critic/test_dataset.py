"""D_elegant is read as it was written, and what cannot be learned from is refused by name."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.critic.dataset import read_elegant, spread, state_columns, with_success_rewards
from jiti.errors import SourceError


def rewrite(root: Path, name: str, change) -> None:
    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    column = change(table[name])
    where = table.column_names.index(name)
    pq.write_table(table.remove_column(where) if column is None else table.set_column(where, name, column), path)


def test_what_was_written_is_read_from_one_file_or_many(make_toy):
    one, many = read_elegant(make_toy("one")), read_elegant(make_toy("many", files=3))
    for name in ("offsets", "action", "reward", "mc_return", "annotated", "split", "task", "episode_ids"):
        assert np.array_equal(getattr(one, name), getattr(many, name)), name
    assert one.gamma == 0.98
    assert one.episodes == 24
    assert one.fingerprint != many.fingerprint
    assert state_columns(one.root, ("observation.state",))["observation.state"].shape == (one.frames, 3)


def test_other_rewards_have_other_returns(toy):
    data = read_elegant(toy)
    other = data.with_rewards(np.ones(data.frames), 0.5)
    assert other.mc_return[data.offsets[1:] - 1].tolist() == [1.0] * data.episodes
    np.testing.assert_allclose(other.mc_return[data.offsets[1:] - 2], 1.5)


def test_a_sparse_label_is_one_at_the_end_of_episodes_that_succeeded(toy):
    data = read_elegant(toy)
    path = toy / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    wins = np.zeros(data.frames, bool)
    wins[data.offsets[1:][::2] - 1] = True
    pq.write_table(table.append_column("next.success", pa.array(wins)), path)
    sparse = with_success_rewards(data)
    assert np.array_equal(sparse.reward > 0, wins)
    assert np.flatnonzero(sparse.annotated).tolist() == (data.offsets[1:][data.labelled] - 1).tolist()
    assert sparse.mc_return[data.offsets[1] - 3] == pytest.approx(data.gamma**2)
    assert sparse.labelled.tolist() == data.labelled.tolist()


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 15, 100])
def test_frames_are_spread_over_all_of_them_and_are_no_more_than_asked(count):
    frames = np.arange(count) + 50
    kept = spread(frames, 8)
    assert len(kept) == len(set(kept.tolist())) == min(count, 8)
    if count:
        assert (kept[0], kept[-1]) == (50, 50 + count - 1)
        assert np.diff(kept, prepend=49).max() <= max(1, -(-count // 7))


@pytest.mark.parametrize("missing", ["next.reward", "elegance.annotated", "elegance.mc_return"])
def test_a_dataset_without_rewards_is_refused(toy, missing):
    info = json.loads((toy / "meta/info.json").read_text())
    del info["features"][missing]
    (toy / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(SourceError, match=rf"has no .*{missing}.*jiti curate"):
        read_elegant(toy)


def test_a_column_that_a_file_lacks_is_named(toy):
    rewrite(toy, "next.reward", lambda _column: None)
    with pytest.raises(SourceError, match=r"file-000\.parquet has no column next\.reward\. Make the dataset again"):
        read_elegant(toy)


def test_a_dataset_without_labels_is_refused(toy):
    rewrite(toy, "elegance.annotated", lambda column: pa.array([False] * len(column)))
    with pytest.raises(SourceError, match=r"no frame is annotated.*jiti annotate"):
        read_elegant(toy)


def test_what_is_not_a_number_is_named_by_its_index(toy):
    def spoil(column):
        values = column.combine_chunks().to_numpy().copy()
        values[17] = np.nan
        return pa.array(values)

    rewrite(toy, "next.reward", spoil)
    with pytest.raises(SourceError, match=r"next\.reward is not a number at index 17"):
        read_elegant(toy)


def test_what_is_no_dataset_is_refused(tmp_path, toy):
    with pytest.raises(SourceError, match=r"is no LeRobot dataset.*jiti curate"):
        read_elegant(tmp_path)
    rewrite(toy, "action", lambda _column: None)
    with pytest.raises(SourceError, match=r"file-000\.parquet"):
        read_elegant(toy)


def test_a_file_that_is_missing_is_noticed(make_toy):
    root = make_toy("many", files=3)
    (root / "data/chunk-000/file-001.parquet").unlink()
    with pytest.raises(SourceError, match="missing"):
        read_elegant(root)
