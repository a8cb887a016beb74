"""Fixtures of the tests of readers."""

import shutil
from pathlib import Path

import pytest

from tests.builders.lerobot import FRONT, WRIST, write_v3


@pytest.fixture(scope="session")
def _whole_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_v3(tmp_path_factory.mktemp("good") / "demo", (12, 9, 15), cameras=(FRONT, WRIST))


@pytest.fixture
def root(_whole_dataset: Path, tmp_path: Path) -> Path:
    """A dataset of three episodes with two cameras, to be spoiled."""
    return Path(shutil.copytree(_whole_dataset, tmp_path / "demo"))
