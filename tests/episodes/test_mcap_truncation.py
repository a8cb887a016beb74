"""Recordings that were cut short."""

from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.episode import ImageBatch, NumericBatch
from jiti.episodes.mcap_episode import McapEpisode
from jiti.episodes.mcap_records import McapFile
from jiti.episodes.mcap_summary import read_indexed
from jiti.errors import SourceError
from tests.builders.mcap import Camera, write_mcap
from tests.builders.mcap_bytes import chunks
from tests.builders.mcap_seen import counts, opened, whats


@pytest.mark.parametrize("layout", [{}, {"compression": "none"}, {"compression": "lz4"}, {"chunked": False}])
def test_a_recording_cut_anywhere_gives_its_beginning_and_says_so(tmp_path: Path, layout: dict) -> None:
    camera = Camera(width=64, height=48, rate_hz=10)
    written = write_mcap(
        tmp_path / "a.mcap", cameras={"/cam": camera}, duration_s=1.5, numeric_hz=10, chunk_size=8_000,
        **{"compression": "none", **layout} if "chunked" in layout else layout,
    )  # fmt: skip
    data = written.path.read_bytes()
    best = 0
    for cut in [*range(0, len(data), 131), len(data) - 1]:
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        try:
            episode = opened(tmp_path / "cut.mcap")
        except SourceError:
            assert best == 0  # once messages could be read, more of the file never gives fewer
            continue
        assert episode.problems
        total = sum(counts(episode).values())
        assert total >= best
        best = total
        assert_prefix(episode, written.times_ns, written.pictures, written.numbers)
    assert best == sum(map(len, written.times_ns.values()))


def assert_prefix(episode: McapEpisode, times: dict, pictures: dict, numbers: dict) -> None:
    """Every stream holds the first of its messages, unchanged."""
    for name, stream in episode.streams.items():
        if stream.kind == "other":
            continue
        batches = list(episode.read([name]))
        found = np.concatenate([b.time_ns for b in batches])
        assert (found == times[name][: len(found)]).all()
        if name in pictures:
            assert [d for b in batches if isinstance(b, ImageBatch) for d in b.data] == pictures[name][: len(found)]
        else:
            values = np.concatenate([b.values for b in batches if isinstance(b, NumericBatch)])
            assert (values == numbers[name][: len(found)]).all()


def test_a_recording_cut_inside_a_chunk_gives_what_that_chunk_still_holds(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", compression="none", chunk_size=100_000)
    data = written.path.read_bytes()
    start, end = chunks(data)[1]
    (tmp_path / "cut.mcap").write_bytes(data[: end - 3000])
    episode = opened(tmp_path / "cut.mcap")
    with McapFile(written.path) as file:
        whole = read_indexed(file)
    in_first = sum(int((rows.chunk == 0).sum()) for rows in whole.rows.values())
    in_both = sum(int((rows.chunk <= 1).sum()) for rows in whole.rows.values())
    assert in_first + 20 < sum(counts(episode).values()) < in_both
    index, cut = whats(episode)
    assert index.startswith("the index cannot be used, because the end of the file is missing: it was cut short, or ")
    there = end - start + 9 - 3000
    assert cut == (
        f"byte {end - 3000} is where the file ends, inside a chunk record at byte {start - 9}: "
        f"{there} of its {end - start + 9} bytes are there"
    )


def test_a_recording_that_ends_in_zeros(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=20_000)
    data = written.path.read_bytes()
    start, _ = chunks(data)[3]
    (tmp_path / "cut.mcap").write_bytes(data[: start - 9] + bytes(5000))
    episode = opened(tmp_path / "cut.mcap")
    assert f"the 5000 bytes from byte {start - 9} on are not MCAP records" in whats(episode)[1]
    assert sum(counts(episode).values()) > 0
