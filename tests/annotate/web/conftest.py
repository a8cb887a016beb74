"""A session over recordings made here, and a client of its app."""

from collections.abc import Callable
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from jiti.annotate.web.app import create_app
from jiti.annotate.web.session import Session, open_session
from tests.builders.mcap import write_mcap

PORT = 4322


@pytest.fixture(autouse=True)
def own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Caches and settings are the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / ".cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / ".config"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two episodes: `episode` of 60 frames and `other` of 30."""
    write_mcap(tmp_path / "episode.mcap", instruction="put the bowl on the plate")
    write_mcap(tmp_path / "other.mcap", duration_s=1)
    return tmp_path


@pytest.fixture
def session(folder: Path) -> Session:
    return open_session(str(folder), annotator="ada", labels=None, tasks=None)


@pytest.fixture
def client() -> Callable[[Session], TestClient]:
    def of(session: Session) -> TestClient:
        app = create_app(session, token="secret", port=PORT)
        return TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers={"Authorization": "Bearer secret"})

    return of
