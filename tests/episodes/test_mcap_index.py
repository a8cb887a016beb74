"""Indexes and summaries: all that writers write, missing, wrong or damaged."""

import itertools
import struct
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import IndexType, Writer

from jiti.episodes.mcap_records import McapFile
from jiti.episodes.mcap_scan import read_unindexed
from jiti.episodes.mcap_summary import NoSummary, read_indexed
from jiti.errors import SourceError
from tests.builders.mcap import START_NS, write_mcap
from tests.builders.mcap_bytes import (
    MESSAGES,
    channel_record,
    chunk,
    chunks,
    handmade,
    message_record,
    record,
    top_level,
)
from tests.builders.mcap_seen import counts, opened, values_in, whats


def test_a_summary_without_channels_and_schemas(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", repeat=False, chunk_size=20_000)
    with McapFile(written.path) as file:
        contents = read_indexed(file)
    assert {c.topic for c in contents.channels.values()} == set(written.times_ns)
    assert counts(opened(written.path)) == {topic: len(times) for topic, times in written.times_ns.items()}


def test_channels_that_are_defined_in_a_chunk_that_is_lost(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", repeat=False, chunk_size=20_000)
    data = bytearray(written.path.read_bytes())
    data[chunks(bytes(data))[0][0] + 60] ^= 0xFF
    written.path.write_bytes(data)
    with pytest.raises(
        SourceError, match=r"no messages that can be read; .*channel 1 has messages, and what it is was"
    ):
        opened(written.path)


def test_a_damaged_summary_is_not_believed(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap")
    data = bytearray(written.path.read_bytes())
    data[-60] ^= 0xFF
    written.path.write_bytes(data)
    episode = opened(written.path)
    assert whats(episode) == ["the index cannot be used, because the summary is damaged (CRC mismatch)"]
    assert episode.problems[0].severity == "warning"
    assert counts(episode) == {topic: len(times) for topic, times in written.times_ns.items()}


@pytest.mark.parametrize("place", [0, 9, 11, 22, 30])
def test_a_damaged_message_index_is_not_believed(tmp_path: Path, place: int) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=20_000)
    data = bytearray(written.path.read_bytes())
    indexes = [start for opcode, start, _ in top_level(bytes(data)) if opcode == Opcode.MESSAGE_INDEX]
    data[indexes[4] - 9 + place] ^= 0x40
    written.path.write_bytes(data)
    episode = opened(written.path)
    assert counts(episode) == {topic: len(times) for topic, times in written.times_ns.items()}
    assert whats(episode) == []


def test_an_index_that_points_elsewhere_costs_that_message_and_says_so(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=20_000)
    data = bytearray(written.path.read_bytes())
    indexes = [start for opcode, start, _ in top_level(bytes(data)) if opcode == Opcode.MESSAGE_INDEX]
    offset = indexes[3] + 6 + 8
    data[offset : offset + 8] = struct.pack("<Q", struct.unpack_from("<Q", data, offset)[0] + 5)
    written.path.write_bytes(data)
    episode = opened(written.path)
    found = counts(episode)
    assert sum(found.values()) == sum(map(len, written.times_ns.values())) - 1
    (what,) = whats(episode)
    assert "1 of 100 messages cannot be used and are left out; of the first, the message index points to som" in what


def test_statistics_that_count_more_messages_than_there_are(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap").path
    data = bytearray(path.read_bytes())
    for opcode, start, _ in top_level(bytes(data)):
        if opcode == Opcode.STATISTICS:
            data[start : start + 8] = struct.pack("<Q", struct.unpack_from("<Q", data, start)[0] + 7)
            counts_at = start + 8 + 2 + 4 * 4 + 16 + 4 + 2
            data[counts_at : counts_at + 8] = struct.pack("<Q", struct.unpack_from("<Q", data, counts_at)[0] + 7)
    without_crc(data)
    path.write_bytes(data)
    (what,) = whats(opened(path))
    assert what == "the statistics count 267 messages, 7 more than are in the file"


def without_crc(data: bytearray) -> None:
    data[-12:-8] = bytes(4)


def test_messages_outside_of_chunks_beside_an_index(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", cameras={}, action_topic=None).path
    data = path.read_bytes()
    (data_end,) = [start - 9 for opcode, start, _ in top_level(data) if opcode == Opcode.DATA_END]
    loose = channel_record(99, "/loose") + message_record(START_NS, 5, 99)
    footer = len(data) - 8 - 20
    summary_start, offsets_start = struct.unpack_from("<QQ", data, footer)
    moved = bytearray(data[:data_end] + loose + data[data_end:])
    struct.pack_into("<QQI", moved, footer + len(loose), summary_start + len(loose), offsets_start + len(loose), 0)
    path.write_bytes(moved)
    episode = opened(path)
    assert counts(episode) == {"/joint_states": 100, "/loose": 1}


def test_unknown_records_and_attachments_are_passed_over(tmp_path: Path) -> None:
    strange = record(0x7F, b"future") + record(0xF0, b"private") + record(Opcode.ATTACHMENT, b"whatever")
    inside = chunk(record(0x42, b"future") + MESSAGES)
    before = b"".join(message_record(k, k) for k in range(20))
    (tmp_path / "a.mcap").write_bytes(handmade(channel_record(), strange, before, strange, inside))
    episode = opened(tmp_path / "a.mcap")
    assert whats(episode) == []
    assert counts(episode) == {"/v": 40}


def test_a_channel_that_is_defined_twice_differently(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(handmade(channel_record(), channel_record(topic="/w"), chunk(MESSAGES)))
    assert whats(opened(tmp_path / "a.mcap")) == [
        "channel 1 is defined twice, differently; the first definition is used"
    ]


def test_times_after_2262_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(handmade(channel_record(), chunk(MESSAGES + message_record(2**63 + 5, 0))))
    episode = opened(tmp_path / "a.mcap")
    assert whats(episode) == ["channel 1 has log times after the year 2262: 1 message is lost (/v 1)"]
    assert counts(episode) == {"/v": 20}


@pytest.mark.parametrize("layout", [{}, {"repeat": False}, {"compression": "lz4"}])
def test_indexed_and_unindexed_contents_are_the_same(tmp_path: Path, layout: dict) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=20_000, instruction="x", **layout)
    with McapFile(written.path) as file:
        by_summary, by_walk = read_indexed(file), read_unindexed(file, "")
    assert by_summary.channels == by_walk.channels
    assert by_summary.schemas == by_walk.schemas
    assert by_summary.chunks == by_walk.chunks
    assert by_summary.metadata == by_walk.metadata
    for channel, rows in by_summary.rows.items():
        for name in ("time_ns", "chunk", "offset"):
            assert (getattr(rows, name) == getattr(by_walk.rows[channel], name)).all()


@pytest.mark.parametrize("use", list(itertools.product((True, False), repeat=3)))
@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE, IndexType.ALL])
def test_every_choice_of_the_librarys_writer(tmp_path: Path, index: IndexType, use: tuple[bool, bool, bool]) -> None:
    repeat, statistics, crcs = use
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(
            file,
            chunk_size=500,
            index_types=index,
            repeat_channels=repeat,
            repeat_schemas=repeat,
            use_statistics=statistics,
            use_summary_offsets=crcs,
            enable_crcs=crcs,
            enable_data_crcs=crcs,
        )
        writer.start()
        schema = writer.register_schema("X", "jsonschema", b"{}")
        for name in ("/a", "/b"):
            writer.register_channel(name, "json", schema)
        writer.add_metadata("m", {"task": "go"})
        writer.add_attachment(0, 0, "a.txt", "text/plain", b"notes")
        for k in range(100):
            writer.add_message(k % 2 + 1, k, b'{"v": %d}' % k, k)
        writer.finish()
    episode = opened(tmp_path / "a.mcap")
    assert whats(episode) == []
    assert (counts(episode), episode.task) == ({"/a": 50, "/b": 50}, "go")
    assert values_in(tmp_path / "a.mcap")


def test_a_definition_that_cannot_be_read_costs_its_own_channel(tmp_path: Path) -> None:
    bad = channel_record(2, "/bad").replace(b"/bad", b"\xff\xff\xff\xff")
    both = chunk(channel_record() + bad + MESSAGES + message_record(5, 1, 2) + message_record(6, 2, 2))
    (tmp_path / "a.mcap").write_bytes(handmade(both))
    episode = opened(tmp_path / "a.mcap")
    assert counts(episode) == {"/v": 20}
    first, second = whats(episode)
    assert first.startswith("a record in chunk 1 is corrupt (a Channel record cannot be read (")
    assert second.startswith(
        "channel 2 has messages, and what it is was lost with another part of the file: 2 messages"
    )


def test_files_without_an_index_are_walked_without_complaint(tmp_path: Path) -> None:
    for layout in ({"indexed": False}, {"summary": False}, {"chunked": False, "compression": "none"}):
        path = write_mcap(tmp_path / "a.mcap", **layout).path  # type: ignore[arg-type]
        with McapFile(path) as file, pytest.raises(NoSummary, match=r"^$"):
            read_indexed(file)
        assert whats(opened(path)) == []
