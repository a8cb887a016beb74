"""Recordings in which single bytes changed: never a crash, never a wrong message, never a loss without a word."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jiti.episodes.episode import ImageBatch, NumericBatch
from jiti.episodes.mcap_episode import McapEpisode
from jiti.errors import SourceError
from tests.builders.mcap import Camera, write_mcap

LAYOUTS = {
    "indexed": {},
    "uncompressed": {"compression": "none"},
    "not repeated": {"repeat": False, "compression": "lz4"},
    "no summary": {"summary": False},
}


@cache
def recording(layout: str) -> bytes:
    with TemporaryDirectory() as folder:
        camera = Camera(width=32, height=24, rate_hz=10)
        options = {"duration_s": 1.0, "numeric_hz": 10, "chunk_size": 4000, **LAYOUTS[layout]}
        return write_mcap(Path(folder) / "a.mcap", cameras={"/cam": camera}, **options).path.read_bytes()  # type: ignore[arg-type]


def content(episode: McapEpisode) -> set[tuple]:
    found = set()
    for batch in episode.read():
        if isinstance(batch, ImageBatch):
            found |= {(batch.stream, int(t), bytes(d)) for t, d in zip(batch.time_ns, batch.data, strict=True)}
        elif isinstance(batch, NumericBatch):
            found |= {(batch.stream, int(t), tuple(v)) for t, v in zip(batch.time_ns, batch.values, strict=True)}
    return found


@cache
def whole(layout: str) -> set[tuple]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        path.write_bytes(recording(layout))
        return content(McapEpisode(path, "a"))


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_changed_bytes(tmp_path: Path, layout: str, data: st.DataObject) -> None:
    changed = bytearray(recording(layout))
    for _ in range(data.draw(st.integers(1, 2))):
        changed[data.draw(st.integers(0, len(changed) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "a.mcap"
    path.write_bytes(changed)
    try:
        episode = McapEpisode(path, "a")
    except SourceError:
        return  # tests of damage check what it says
    found = content(episode)
    assert found <= whole(layout)
    assert found == whole(layout) or episode.problems
