"""Fixtures that every test folder shares."""

import os
from pathlib import Path

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """For processes that tests start: let them keep what they compile, for to import everything anew takes seconds."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ.setdefault("PYTHONPYCACHEPREFIX", str(config.rootpath / ".pytest_cache" / "bytecode"))
    # As `jiti.annotate.engine` sets it, which is too late where a test imports Ray before.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Real recordings that lie beside the checkout where there are any."""
    folder = Path(__file__).parents[2] / "shared"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: put the project's shared folder beside the checkout")
    return folder
