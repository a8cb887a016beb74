"""Fixtures that every test folder shares."""

import os
from pathlib import Path

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Let processes that tests start keep what they compile: to import everything anew takes each of them seconds."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ.setdefault("PYTHONPYCACHEPREFIX", str(config.rootpath / ".pytest_cache" / "bytecode"))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Real recordings that lie beside the checkout where there are any."""
    folder = Path(__file__).parents[2] / "shared"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: put the project's shared folder beside the checkout")
    return folder
