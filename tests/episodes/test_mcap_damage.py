"""Recordings with corrupt chunks, or that are none: what can be read is read, and what is lost is said."""

import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode

from jiti.episodes.mcap_contents import Contents
from jiti.episodes.mcap_records import MAGIC, McapFile
from jiti.episodes.mcap_summary import read_indexed
from jiti.errors import SourceError
from tests.builders.mcap import write_mcap
from tests.builders.mcap_bytes import MESSAGES, channel_record, chunk, chunks, handmade, message_record, record
from tests.builders.mcap_seen import counts, opened, values_in, whats


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
    tracemalloc.start()
    episode = opened(tmp_path / "a.mcap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 << 20
    assert [what.split("(")[1].split(" instead")[0] for what in whats(episode)] == [
        "it holds 268435456 bytes",
        "it unpacks to more than 1000 bytes",
    ]
