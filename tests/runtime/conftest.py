"""What the tests in simulation need of the machine."""

import importlib.util
import os
from pathlib import Path

import pytest

from jiti.runtime.sim.gl import Graphics, find_graphics


@pytest.fixture(autouse=True)
def _simulator(request: pytest.FixtureRequest) -> None:
    if request.node.get_closest_marker("sim") and importlib.util.find_spec("robosuite") is None:
        pytest.skip("robosuite is not installed: pip install 'jiti[sim]'")


@pytest.fixture(scope="session")
def graphics() -> Graphics:
    """The GL library that renders here."""
    found = find_graphics()
    if found.backend is None:
        if os.environ.get("CI"):
            pytest.fail(found.message)
        pytest.skip(found.message)
    return found


@pytest.fixture(scope="session")
def libero_assets(shared: Path) -> Path:
    """LIBERO's own assets."""
    folder = shared / "libero-assets"
    if not folder.is_dir():
        pytest.skip(f"no assets of LIBERO at {folder}")
    return folder
