"""A dataset of jiti that is curated again keeps its splits, unless others are asked for."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.curate.export.curated import Curated
from jiti.errors import SourceError, UsageError
from jiti.tasks.catalogue import load_catalogue
from tests.builders.curate import curated, write_picks

GOOD = [(2, 6, 1)]


def splits(dataset: Path) -> dict[str, str]:
    """By source's name and the episode's id in it."""
    rows = pq.read_table(dataset / "meta" / "jiti" / "episodes.parquet").to_pylist()
    return {f"{row['source']}/{row['episode_id']}": row["split"] for row in rows}


def short(folder: Path, count: int, instruction: str) -> Path:
    return write_picks(folder, [GOOD] * count, instruction=instruction, duration_s=0.3)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve episodes of two tasks, one of which is unseen."""
    folder = tmp_path_factory.mktemp("splits")
    one, other = short(folder / "cube", 8, "pick the cube"), short(folder / "bowl", 4, "pick the bowl")
    curated(one, other, out=folder / "d", split="0.5,0.25,0.25", seed=3, unseen=("pick the bowl",))
    return folder / "d"


def test_splits_are_kept_and_it_is_told(whole, tmp_path):
    done: Curated = curated(whole, out=tmp_path / "e")
    assert list(splits(tmp_path / "e").values()) == list(splits(whole).values())
    assert done.splits == {"train": 4, "validation": 2, "test": 2, "unseen": 4}
    assert "Splits are those of d; --split, --seed or --unseen deals all of them anew." in str(done)
    train = curated(whole, out=tmp_path / "train", condition="split == 'train'")
    assert train.splits == {"train": 4}


@pytest.mark.parametrize("options", [{"split": "0.8,0.1,0.1"}, {"seed": 0}, {"unseen": ("pick the cube",)}])
def test_splits_are_dealt_anew_when_asked(whole, tmp_path, options):
    done = curated(whole, out=tmp_path / "e", **options)
    assert list(splits(tmp_path / "e").values()) != list(splits(whole).values())
    assert "Splits were dealt anew; those of d were not kept." in str(done)


def test_recordings_beside_a_dataset_are_dealt_and_an_unseen_task_stays_unseen(whole, tmp_path):
    more = short(tmp_path / "more", 3, "pick the bowl")
    done = curated(whole, more, out=tmp_path / "e")
    found = splits(tmp_path / "e")
    assert {split for name, split in found.items() if name.startswith("more/")} == {"unseen"}
    assert done.splits["unseen"] == 7
    seen = curated(more, out=tmp_path / "seen")
    assert "Splits" not in str(seen)
    with pytest.raises(UsageError, match="pick the bowl is unseen in d and in the split train of seen"):
        curated(whole, tmp_path / "seen", out=tmp_path / "f")


def test_the_end_of_a_tasks_id_is_enough_for_unseen(tmp_path):
    first, second = (load_catalogue().task(f"elegant/T{number}").instruction for number in (0, 1))
    one, other = short(tmp_path / "one", 2, first), short(tmp_path / "other", 2, second)
    assert curated(one, other, out=tmp_path / "d", unseen=("T1",)).splits == {"train": 2, "unseen": 2}
    rows = pq.read_table(tmp_path / "d" / "meta" / "jiti" / "episodes.parquet").to_pylist()
    assert {row["task_id"] for row in rows if row["split"] == "unseen"} == {"elegant/T1"}
    with pytest.raises(UsageError, match="--unseen T9: no episode has that task; there are: elegant/T0, elegant/T1"):
        curated(one, other, out=tmp_path / "e", unseen=("T9",))


def test_a_split_that_no_one_knows_is_refused(tmp_path):
    curated(short(tmp_path / "cube", 2, "pick the cube"), out=tmp_path / "d")
    path = tmp_path / "d" / "meta" / "jiti" / "episodes.parquet"
    table = pq.read_table(path)
    place = table.schema.get_field_index("split")
    pq.write_table(table.set_column(place, table.schema.field(place), pa.array(["train", "exam"])), path)
    with pytest.raises(SourceError, match="has the split 'exam'; there are: train, validation, test, unseen"):
        curated(tmp_path / "d", out=tmp_path / "e")
    assert curated(tmp_path / "d", out=tmp_path / "e", seed=0).episodes == 2
