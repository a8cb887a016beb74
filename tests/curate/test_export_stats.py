"""Our statistics against lerobot's own functions."""

import numpy as np
import pytest

from jiti.curate.export.stats import LevelStats, column_stats, merged, sampled, thinned

pytestmark = pytest.mark.slow  # lerobot takes ten seconds to import


@pytest.fixture(scope="module")
def theirs():
    return pytest.importorskip("lerobot.datasets.compute_stats", reason="install jiti[learn]")


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(0).normal(size=(200, 5)).astype(np.float32),
        np.random.default_rng(1).normal(size=180).astype(np.float32),
        np.zeros((50, 3), np.float32),
        np.arange(90),
        np.arange(40) > 20,
        np.full((1, 4), 2.5, np.float32),
        np.array([7]),
    ],
    ids=["vector", "number", "constant", "index", "flag", "one row", "one index"],
)
def test_columns_have_lerobots_numbers_to_the_last_bit(theirs, values):
    expected = theirs.get_feature_stats(values, axis=0, keepdims=values.ndim == 1)
    found = column_stats(values)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].shape == value.shape
        assert found[name].tolist() == value.tolist(), name


def test_a_dataset_has_lerobots_numbers(theirs):
    rng = np.random.default_rng(0)
    parts = [{"a": column_stats(rng.normal(size=(n, 3)).astype(np.float32))} for n in (10, 200, 35)]
    total = expected = None
    for part in parts:
        total = merged(total, part)
        expected = theirs.aggregate_stats([expected, part]) if expected else part
    assert total is not None
    assert expected is not None
    for name, value in expected["a"].items():
        assert total["a"][name].tolist() == value.tolist(), name


def test_pictures_have_lerobots_numbers_where_its_sums_do_not_round(theirs):
    rng = np.random.default_rng(0)
    pictures = rng.integers(10, 200, (6, 12, 16, 3), dtype=np.uint8)
    levels = LevelStats()
    for picture in pictures:
        levels.add(picture)
    expected = theirs.get_feature_stats(pictures.transpose(0, 3, 1, 2), axis=(0, 2, 3), keepdims=True)
    found = levels.stats()
    assert found["count"].tolist() == expected["count"].tolist()
    for name in found.keys() - {"count"}:
        assert found[name].shape == (3, 1, 1)
        np.testing.assert_allclose(found[name], np.squeeze(expected[name] / 255.0, axis=0), rtol=2e-5, err_msg=name)


def test_the_same_pictures_are_looked_at(theirs):
    for count in (1, 2, 99, 100, 101, 500, 1000, 30_000):
        assert sampled(count).tolist() == theirs.sample_indices(count)
    for height, width in ((240, 320), (200, 200), (480, 640), (720, 200)):
        picture = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
        expected = theirs.auto_downsample_height_width(picture.transpose(2, 0, 1))
        assert np.array_equal(thinned(picture).transpose(2, 0, 1), expected)
