"""Lighter copies: made once, readable while they are made, with the times of the recording."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from jiti.annotate.web.proxy import Proxy
from jiti.annotate.web.session import Session
from jiti.errors import SourceError


def finished(proxy: Proxy) -> Proxy:
    end = time.monotonic() + 60
    while not proxy.done and proxy.error is None and time.monotonic() < end:
        time.sleep(0.02)
    return proxy


def test_a_recording_that_is_too_large_is_shown_through_a_copy(
    client: Callable[[Session], TestClient], session: Session
) -> None:
    session.viewer_bytes = 1000
    api = client(session)
    assert "more than the viewer can hold" in api.get("/api/episodes/episode").json()["proxy_reason"]
    while_made = api.get("/api/episodes/episode/recording.rrd").content
    state = api.get("/api/episodes/episode/proxy").json()["proxy"]
    assert state == {"done": True, "frames_done": 60, "frame_count": 60, "seconds_left": 0.0, "error": None}
    assert api.get("/api/episodes/episode/recording.rrd").content == while_made


def test_a_copy_is_made_once_and_kept(session: Session) -> None:
    episode = session.episode("episode")
    first = Proxy(episode, "episode", max_height=120)
    content = b"".join(first.read())
    again = Proxy(episode, "episode", max_height=120)
    assert again.done
    assert b"".join(again.read()) == content
    assert list(first.path.parent.iterdir()) == [first.path]


def test_a_recording_that_can_be_shown_needs_no_copy(session: Session) -> None:
    assert session.proxy(session.episode("episode")) is None


def test_a_copy_that_cannot_be_made_says_so_and_leaves_nothing(
    session: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    episode = session.episode("episode")
    (tmp_path / "episode.mcap").unlink()
    proxy = Proxy(episode, "episode", max_height=120)
    with pytest.raises(SourceError, match=r"episode\.mcap"):
        b"".join(proxy.read())
    assert finished(proxy).error is not None
    assert list(proxy.path.parent.iterdir()) == []
