"""Reading holds one chunk, not the recording."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.mcap_episode import McapEpisode
from tests.builders.encode import encode_numbered
from tests.builders.mcap import START_NS, Channel, Message, write_messages
from tests.builders.mcap_messages import picture

SIZE = 100_000


@pytest.mark.parametrize("layout", [{}, {"summary": False}, {"chunked": False, "compression": "none"}])
def test_memory_is_bounded_by_chunks(tmp_path: Path, layout: dict) -> None:
    head = encode_numbered([0], "jpeg", 64, 48)[0]
    noise = np.random.default_rng(0).bytes(SIZE)
    made = [picture("protobuf", "jpeg", 64, 48, START_NS, head + bytes([k]) + noise) for k in range(8)]
    messages = (Message("/cam", START_NS + k * 33_333_333, made[k % 8][1]) for k in range(600))
    write_messages(
        tmp_path / "a.mcap", {"/cam": Channel(made[0][0], "protobuf")}, messages, chunk_size=1 << 20, **layout
    )
    tracemalloc.start()
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    opening = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    total = sum(len(data) for batch in episode.read() for data in batch.data)  # type: ignore[union-attr]
    reading = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert total > 600 * SIZE
    assert total <= episode.image_bytes < total * 1.01
    # A chunk as stored, unpacked, and as pictures, twice over while the next one replaces it.
    assert opening < 5 << 20
    assert reading < 6 << 20
