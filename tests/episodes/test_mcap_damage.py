"""Recordings that are damaged, or are none: what can be read is read, and what is lost is said."""

import itertools
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import IndexType, Writer

from jiti.episodes.episode import ImageBatch, NumericBatch
from jiti.episodes.mcap_contents import Contents
from jiti.episodes.mcap_episode import McapEpisode
from jiti.episodes.mcap_records import MAGIC, McapFile
from jiti.episodes.mcap_scan import read_unindexed
from jiti.episodes.mcap_summary import NoSummary, read_indexed
from jiti.errors import SourceError
from tests.builders.mcap import START_NS, Camera, Channel, Message, write_mcap, write_messages
from tests.builders.mcap_messages import Schema, json_schema, vector


def opened(path: Path) -> McapEpisode:
    return McapEpisode(path, "a")


def whats(episode: McapEpisode) -> list[str]:
    return [problem.what for problem in episode.problems]


def counts(episode: McapEpisode) -> dict[str, int]:
    found = dict.fromkeys((s.name for s in episode.streams.values() if s.kind != "other"), 0)
    for batch in episode.read():
        found[batch.stream] += len(batch.time_ns)
    return found


def top_level(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start of content and end of each record of a file."""
    position = len(MAGIC)
    while position < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, position)
        yield opcode, position + 9, position + 9 + length
        position += 9 + length


def chunks(data: bytes) -> list[tuple[int, int]]:
    return [(start, end) for opcode, start, end in top_level(data) if opcode == Opcode.CHUNK]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(
    records: bytes,
    *,
    unpacked: int | None = None,
    crc: int | None = None,
    compression: str = "",
    stored: bytes | None = None,
) -> bytes:
    """A chunk record around records."""
    name = compression.encode()
    body = records if stored is None else stored
    size = len(records) if unpacked is None else unpacked
    head = struct.pack("<QQQII", 0, 2**62, size, zlib.crc32(records) if crc is None else crc, len(name))
    return record(Opcode.CHUNK, head + name + struct.pack("<Q", len(body)) + body)


def handmade(*parts: bytes) -> bytes:
    """A file without a summary."""
    header = record(Opcode.HEADER, struct.pack("<II", 0, 0))
    footer = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20))
    return MAGIC + header + b"".join(parts) + footer + MAGIC


def channel_record(number: int = 1, topic: str = "/v", schema: int = 0, encoding: str = "json") -> bytes:
    name, kind = topic.encode(), encoding.encode()
    content = struct.pack("<HHI", number, schema, len(name)) + name + struct.pack("<I", len(kind)) + kind
    return record(Opcode.CHANNEL, content + struct.pack("<I", 0))


def message_record(time_ns: int, value: float, number: int = 1) -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + b'{"v": %g}' % value)


MESSAGES = b"".join(message_record(1000 + k, k) for k in range(20))


def values_in(path: Path) -> list[float]:
    return [v for b in opened(path).read() if isinstance(b, NumericBatch) for v in b.values[:, 0].tolist()]


# Files that are no recordings


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"a\.mcap is empty \(0 bytes\)\. Copy it"),
        (MAGIC[:5], r"a\.mcap ends after 5 bytes, before its first record\. Copy it"),
        (b"\x1f\x8b\x08\x00" * 8, r"a\.mcap is not an MCAP file: it starts with 1f 8b 08 00 .* Pass a recording"),
        (MAGIC, r"a\.mcap has no messages that can be read; what was found: the index cannot be used"),
        (MAGIC + bytes(100), r"the 100 bytes from byte 8 on are not MCAP records"),
        (MAGIC + b"\x06" + b"\xff" * 60, r"is where the file ends, inside a chunk record at byte 8"),
        (handmade(), r"a\.mcap has no messages that can be read; channels declared: none\. Copy it"),
        (handmade(channel_record()), r"has no messages that can be read; channels declared: /v\. "),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(SourceError, match=message):
        opened(tmp_path / "a.mcap")


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"a\.mcap cannot be read: no such file or directory"):
        opened(tmp_path / "a.mcap")
    (tmp_path / "b.mcap").mkdir()
    with pytest.raises(SourceError, match=r"b\.mcap cannot be read"):
        opened(tmp_path / "b.mcap")


# Corrupt chunks


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_corrupt_chunk_costs_its_own_messages_and_says_which(tmp_path: Path, compression: str, indexed: bool) -> None:
    written = write_mcap(tmp_path / "a.mcap", compression=compression, chunk_size=40_000)  # type: ignore[arg-type]
    data = bytearray(written.path.read_bytes())
    places = chunks(bytes(data))
    start, end = places[2]
    data[end - 300 : end - 290] = b"\0" * 10
    if not indexed:
        del data[-1]  # the summary cannot be found
    written.path.write_bytes(data)
    with McapFile(written.path) as file:
        lost = {  # what the untouched message index says of the chunk
            channel: int((rows.chunk == 2).sum()) for channel, rows in by_index(file).rows.items()
        }
    episode = opened(written.path)
    found = counts(episode)
    total = sum(lost.values())
    texts = [what for what in whats(episode) if what.startswith("chunk ")]
    assert len(texts) == 1
    assert texts[0].startswith(f"chunk 3 of {len(places)} at byte {start - 9} is corrupt (")
    assert f": {total} messages between 0." in texts[0]
    assert f"are lost (/camera/front {lost[1]}, /joint_states {lost[2]}, /action {lost[3]})" in texts[0]
    assert found == {topic: len(times) - lost[k + 1] for k, (topic, times) in enumerate(written.times_ns.items())}
    counts(episode)
    assert len([what for what in whats(episode) if what.startswith("chunk ")]) == 1  # said once, however often read


def by_index(file: McapFile) -> Contents:
    """Contents by message indexes alone, of a file whose last byte may be missing."""
    if file.read(file.size - 8, 8) == MAGIC:
        return read_indexed(file)
    whole = file.path.with_suffix(".whole")
    whole.write_bytes(file.path.read_bytes() + MAGIC[-1:])
    with McapFile(whole) as again:
        return read_indexed(again)


def test_check_finds_corrupt_chunks_without_reading_streams(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=40_000)
    data = bytearray(written.path.read_bytes())
    for start, _ in chunks(bytes(data))[1:3]:
        data[start + 100] ^= 0xFF
    written.path.write_bytes(data)
    episode = opened(written.path)
    assert whats(episode) == []
    assert [problem.severity for problem in episode.check()] == ["error", "error"]


def test_many_corrupt_chunks_are_one_problem(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=20_000, compression="none")
    data = bytearray(written.path.read_bytes())
    for start, _ in chunks(bytes(data))[1:]:
        data[start + 24] ^= 0xFF  # the CRC
    written.path.write_bytes(data)
    episode = opened(written.path)
    counts(episode)
    (what,) = whats(episode)
    assert "chunks, the first at byte" in what
    assert "each of which is corrupt (CRC mismatch): " in what


def test_a_chunk_whose_head_is_damaged_does_not_hide_the_others(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", chunk_size=40_000)
    data = bytearray(written.path.read_bytes())
    start, _ = chunks(bytes(data))[1]
    data[start - 8 : start] = struct.pack("<Q", 2**60)  # a length of 10^18
    written.path.write_bytes(data)
    episode = opened(written.path)
    (what,) = whats(episode)
    assert "is corrupt (there is no chunk of that length): " in what
    assert sum(counts(episode).values()) == sum(map(len, written.times_ns.values())) - int(
        what.split(": ")[1].split()[0]
    )


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (chunk(MESSAGES, crc=1), r"CRC mismatch"),
        (chunk(MESSAGES, unpacked=len(MESSAGES) + 1), "it unpacks to"),
        (chunk(MESSAGES, compression="zstd", stored=b"no zstd at all"), "it does not decompress"),
        (chunk(MESSAGES, compression="lz4", stored=b"no lz4 at all"), "it does not decompress"),
        (chunk(MESSAGES, compression="zstd", stored=zstandard.compress(MESSAGES)[:-9]), "it does not decompress"),
        (chunk(MESSAGES, compression="lz4", stored=lz4.frame.compress(MESSAGES)[:-9]), "it unpacks to 0 bytes instead"),
        (chunk(MESSAGES, compression="zstd", stored=zstandard.compress(MESSAGES * 2)), "it holds 1580 bytes instead"),
        (chunk(MESSAGES, compression="lz4", stored=lz4.frame.compress(MESSAGES * 2)), "it unpacks to more than"),
        (chunk(MESSAGES, compression="zstd", unpacked=2**31, stored=b""), "the limit is 1073741824"),
        (chunk(MESSAGES, compression="xz", stored=b"?"), "its compression 'xz' is not known; known are zstd, lz4 and"),
        (chunk(MESSAGES[:-5], crc=0), "unpacked bytes runs past their end"),
        (record(Opcode.CHUNK, b"short"), "the head of the chunk is incomplete"),
        (record(Opcode.CHUNK, struct.pack("<QQQII", 0, 0, 9, 0, 9999) + bytes(99)), "would be 9999 bytes long"),
        (record(Opcode.CHUNK, struct.pack("<QQQIIQ", 0, 0, 9, 0, 0, 77)), "it claims 77 bytes of records, and its rec"),
    ],
)
def test_every_kind_of_corrupt_chunk(tmp_path: Path, made: bytes, reason: str) -> None:
    good = chunk(message_record(1, 100) + message_record(2, 101))
    (tmp_path / "a.mcap").write_bytes(handmade(channel_record(), good, made, chunk(message_record(3, 102))))
    episode = opened(tmp_path / "a.mcap")
    (what,) = whats(episode)
    assert what.startswith("chunk 2 of 3 at byte ")
    assert reason in what
    assert values_in(tmp_path / "a.mcap") == [100, 101, 102]


def test_a_zstd_chunk_without_a_declared_size(tmp_path: Path) -> None:
    compressor = zstandard.ZstdCompressor(write_content_size=False)
    made = chunk(MESSAGES, compression="zstd", stored=compressor.compress(MESSAGES))
    (tmp_path / "a.mcap").write_bytes(handmade(channel_record(), made))
    assert values_in(tmp_path / "a.mcap") == list(range(20))


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    bomb = zstandard.compress(bytes(1 << 28))
    made = chunk(b"", unpacked=1000, crc=0, compression="zstd", stored=bomb)
    lz4_bomb = chunk(b"", unpacked=1000, crc=0, compression="lz4", stored=lz4.frame.compress(bytes(1 << 26)))
    (tmp_path / "a.mcap").write_bytes(handmade(channel_record(), chunk(MESSAGES), made, lz4_bomb))
    import tracemalloc

    tracemalloc.start()
    episode = opened(tmp_path / "a.mcap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 << 20
    assert [what.split("(")[1].split(" instead")[0] for what in whats(episode)] == [
        "it holds 268435456 bytes",
        "it unpacks to more than 1000 bytes",
    ]


# Indexes and summaries


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


# Messages


def test_encodings_that_are_not_supported(tmp_path: Path) -> None:
    schema, data = vector("json", [1.0], 0)
    channels = {
        "/v": Channel(schema, "json"),
        "/flat": Channel(Schema("x.Y", "flatbuffer", b"bfbs", "flatbuffer"), "flatbuffer"),
        "/ros1": Channel(Schema("std_msgs/String", "ros1msg", b"string data", "ros1"), "ros1"),
        "/idl": Channel(Schema("a/msg/B", "ros2idl", b"module a {};", "cdr"), "cdr"),
        "/none": Channel(None, ""),
        "/bad": Channel(Schema("t.Bad", "protobuf", b"not a descriptor", "protobuf"), "protobuf"),
    }
    messages = [Message(topic, k, data if topic == "/v" else b"\1\2") for k in range(5) for topic in channels]
    write_messages(tmp_path / "a.mcap", channels, messages)
    episode = opened(tmp_path / "a.mcap")
    assert {s.name: s.kind for s in episode.streams.values()} == dict.fromkeys(channels, "other") | {"/v": "numeric"}
    texts = [str(problem) for problem in episode.problems]
    assert len(texts) == 5
    assert texts[0].startswith(
        "a.mcap, /flat: channel 2 cannot be read: its messages are 'flatbuffer' with 'flatbuffer' schemas. Record it, "
        "or convert it, as one of these: Protobuf (`protobuf`), ROS 2 CDR"
    )
    assert "its messages are 'ros1' with 'ros1msg' schemas" in texts[1]
    assert "its messages are 'cdr' with 'ros2idl' schemas" in texts[2]
    assert "its messages are 'of no declared encoding' with 'no' schemas" in texts[3]
    assert "the schema of t.Bad cannot be read" in texts[4]
    with pytest.raises(
        SourceError, match=r"/flat: it cannot be read: its messages are 'flatbuffer'.*Readable are: .*/v"
    ):
        episode.read(["/flat"])


def test_messages_that_do_not_decode_are_left_out_and_counted(tmp_path: Path) -> None:
    payloads = [b'{"v": %d}' % k if k not in (7, 8, 30) else b"{broken" for k in range(40)]
    channels = {"/v": Channel(json_schema("X"), "json")}
    write_messages(tmp_path / "a.mcap", channels, [Message("/v", k * 10**8, p) for k, p in enumerate(payloads)])
    episode = opened(tmp_path / "a.mcap")
    assert counts(episode) == {"/v": 37}
    (problem,) = episode.problems
    assert problem.where == "a.mcap, /v, message 7 at 0.700 s"
    assert problem.what.startswith("3 of 40 messages cannot be used and are left out; of the first, it is not JSON (")


def test_streams_whose_length_changes(tmp_path: Path) -> None:
    payloads = [
        b'{"v": [1, 2, 3]}',
        b'{"v": [1, 2]}',
        b'{"v": [1, 2, 3, 4]}',
        b'{"v": [1, 2, 3, 4, 5]}',
        b'{"v": [9, 9, 9]}',
    ]
    channels = {"/v": Channel(json_schema("X"), "json")}
    write_messages(tmp_path / "a.mcap", channels, [Message("/v", k, p) for k, p in enumerate(payloads)])
    episode = opened(tmp_path / "a.mcap")
    assert episode.streams["/v"].shape == (3,)
    (batch,) = episode.read()
    assert isinstance(batch, NumericBatch)
    np.testing.assert_array_equal(batch.values, [[1, 2, 3], [1, 2, np.nan], [1, 2, 3], [1, 2, 3], [9, 9, 9]])
    assert whats(episode) == [
        "its messages do not all have the same numbers; where 'v[2]' is missing it is NaN",
        "numbers that neither the first nor the last message has are left out, such as 'v[3]'",
    ]


# Truncation


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


# Both ways of reading


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
