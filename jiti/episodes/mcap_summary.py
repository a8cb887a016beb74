"""The contents of an MCAP file from its summary and its message indexes, without unpacking its chunks."""

import struct
import zlib
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Footer, Statistics

from jiti.episodes.mcap_contents import (
    MAX_METADATA_BYTES,
    Contents,
    ContentsBuilder,
    Loss,
    fits,
    lost_with,
)
from jiti.episodes.mcap_records import (
    MAGIC,
    RECORD,
    Chunk,
    McapFile,
    RecordDamaged,
    check_unpackable,
    chunk_at,
    parse,
    records,
)

FOOTER_BYTES = RECORD.size + 20
INDEX_HEAD = struct.Struct("<QQQQI")
"""Of a chunk index: first and last log time, offset and length of the chunk, length of the map that follows."""
MESSAGE_INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode, length of content, channel, bytes of entries."""


class NoSummary(Exception):
    """The file must be read from its start; the message says why, and is empty when that is as it was written."""


@dataclass(frozen=True, slots=True)
class _Indexed:
    """A chunk as the summary describes it."""

    offset: int
    length: int
    first_ns: int
    last_ns: int
    index_length: int
    compression: str
    stored_size: int
    unpacked_size: int

    @property
    def end(self) -> int:
        return self.offset + self.length


@dataclass(slots=True)
class _Summary:
    start: int
    chunks: list[_Indexed] = field(default_factory=list)
    statistics: Statistics | None = None


def read_indexed(file: McapFile) -> Contents:
    """Contents by the summary. Raises NoSummary when it is not there, is damaged or does not cover the file."""
    builder = ContentsBuilder(file)
    try:
        summary = _read_summary(file, builder)
    except RecordDamaged as error:
        raise NoSummary(str(error)) from error
    _read_between(file, summary, builder)
    unindexed = []
    for number, indexed in enumerate(summary.chunks):
        entries = None
        try:
            chunk = chunk_at(file, number, *_checked_place(file, indexed))
            _check_head(chunk, indexed)
            check_unpackable(chunk)
        except RecordDamaged as error:
            # What the index says of it stands in for the chunk, so that numbers of chunks stay those of the file.
            chunk = Chunk(number, indexed.offset, indexed.offset, 0, indexed.unpacked_size, indexed.compression, 0)
            builder.add(chunk)
            builder.contents.losses.append(lost_with(chunk, str(error), _entries_or_none(file, indexed)))
            continue
        builder.add(chunk)
        entries = _entries_or_none(file, indexed)
        if entries is not None and fits(entries, chunk, indexed.first_ns, indexed.last_ns):
            builder.add_entries(number, entries)
        else:
            unindexed.append(chunk)
    for chunk in unindexed:
        builder.scan_into(chunk)
    _find_definitions(builder)
    _compare(builder, summary)
    return builder.finish()


def _read_summary(file: McapFile, builder: ContentsBuilder) -> _Summary:
    if file.size < len(MAGIC) * 2 + FOOTER_BYTES or file.read(file.size - len(MAGIC), len(MAGIC)) != MAGIC:
        raise NoSummary("the end of the file is missing: it was cut short, or its recorder was stopped")
    footer_at = file.size - len(MAGIC) - FOOTER_BYTES
    if file.record(footer_at) != (Opcode.FOOTER, 20):
        raise NoSummary("the footer is damaged")
    footer = parse(Footer, file.read(footer_at + RECORD.size, 20))
    if not footer.summary_start:
        raise NoSummary("")
    if not len(MAGIC) <= footer.summary_start < footer_at:
        raise NoSummary("the footer is damaged")
    # The CRC covers the summary and the footer up to the CRC itself.
    data = file.read(footer.summary_start, file.size - len(MAGIC) - 4 - footer.summary_start)
    if footer.summary_crc and zlib.crc32(data) != footer.summary_crc:
        raise NoSummary("the summary is damaged (CRC mismatch)")
    summary = _Summary(footer.summary_start)
    block = data[: footer_at - footer.summary_start]
    for opcode, start, end in records(block):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            builder.define(opcode, block[start:end])
        elif opcode == Opcode.STATISTICS:
            summary.statistics = parse(Statistics, block[start:end])
        elif opcode == Opcode.CHUNK_INDEX:
            summary.chunks.append(_chunk_index(block[start:end]))
    summary.chunks.sort(key=lambda chunk: chunk.offset)
    return summary


def _chunk_index(content: bytes) -> _Indexed:
    """The library's own reader builds a dictionary a chunk, which takes seconds with hundreds of channels."""
    try:
        first, last, offset, length, offsets_length = INDEX_HEAD.unpack_from(content)
        index_length, name_length = struct.unpack_from("<QI", content, INDEX_HEAD.size + offsets_length)
        name_at = INDEX_HEAD.size + offsets_length + 12
        name = content[name_at : name_at + name_length].decode("utf-8", "replace")
        stored, unpacked = struct.unpack_from("<QQ", content, name_at + name_length)
    except struct.error as error:
        raise RecordDamaged(f"a ChunkIndex record cannot be read ({error})") from error
    return _Indexed(offset, length, first, last, index_length, name, stored, unpacked)


def _read_between(file: McapFile, summary: _Summary, builder: ContentsBuilder) -> None:
    """Look at the records outside of indexed chunks. Raises NoSummary when there are messages among them."""
    position = len(MAGIC)
    ends = [(chunk.offset, chunk.end + chunk.index_length) for chunk in summary.chunks]
    for gap_end, next_position in [*ends, (summary.start, summary.start)]:
        if gap_end < position:
            raise NoSummary("the summary is damaged (its chunks overlap)")
        try:
            while position < gap_end:
                opcode, length = file.record(position)
                if position + RECORD.size + length > gap_end:
                    raise RecordDamaged(f"a record of {length} bytes does not fit")
                if opcode in (Opcode.MESSAGE, Opcode.CHUNK):
                    raise NoSummary("")
                if opcode != Opcode.METADATA or length <= MAX_METADATA_BYTES:
                    _define(file, builder, opcode, position, length)
                position += RECORD.size + length
        except RecordDamaged as error:
            what = f"hold nothing that can be read ({error})"
            builder.contents.losses.append(Loss(f"bytes {position} to {gap_end}", what, {}))
        position = next_position


def _define(file: McapFile, builder: ContentsBuilder, opcode: int, position: int, length: int) -> None:
    if opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
        content = file.read(position + RECORD.size, length)
        builder.define_or_lose(opcode, content, f"the record at byte {position}")


def _checked_place(file: McapFile, indexed: _Indexed) -> tuple[int, int]:
    if indexed.end > file.size:
        raise RecordDamaged("it lies past the end of the file")
    opcode, length = file.record(indexed.offset)
    if opcode != Opcode.CHUNK or length != indexed.length - RECORD.size:
        raise RecordDamaged("there is no chunk of that length")
    return indexed.offset, length


def _check_head(chunk: Chunk, indexed: _Indexed) -> None:
    if (chunk.compression, chunk.unpacked_size) != (indexed.compression, indexed.unpacked_size):
        raise RecordDamaged("its head and the summary disagree")


def _entries_or_none(file: McapFile, indexed: _Indexed) -> dict[int, bytes] | None:
    """The message index that follows a chunk: ENTRY records by channel. None when it is not there or not whole."""
    if not indexed.index_length:
        return None
    try:
        block = file.read(indexed.end, indexed.index_length)
    except RecordDamaged:
        return None
    return entries_in(block)


def entries_in(block: bytes) -> dict[int, bytes] | None:
    """Message index records as ENTRY records by channel; None when there is anything else among them."""
    entries: dict[int, bytes] = {}
    position = 0
    while position < len(block):
        if position + MESSAGE_INDEX_HEAD.size > len(block):
            return None
        opcode, length, channel, size = MESSAGE_INDEX_HEAD.unpack_from(block, position)
        start = position + MESSAGE_INDEX_HEAD.size
        if opcode != Opcode.MESSAGE_INDEX or length < size + 6 or size % 16 or start + size > len(block):
            return None
        if size:
            entries[channel] = entries.get(channel, b"") + block[start : start + size]
        position += RECORD.size + length
    return entries


def _find_definitions(builder: ContentsBuilder) -> None:
    """Find channels that the summary does not repeat where their first messages are."""
    for channel in sorted(builder.undefined()):
        for number in builder.chunks_of(channel):
            if channel in builder.contents.channels:
                break
            try:
                builder.scan(builder.contents.chunks[number])
            except RecordDamaged:
                continue  # reading its messages reports it


def _compare(builder: ContentsBuilder, summary: _Summary) -> None:
    """Believe the chunks, not their indexes, where the statistics count more messages than are indexed."""
    if summary.statistics is None or builder.contents.losses:
        return
    expected = {c: n for c, n in summary.statistics.channel_message_counts.items() if n}
    if expected == builder.counts():
        return
    builder.scan_all(builder.contents.chunks)
    missing = summary.statistics.message_count - sum(builder.counts().values())
    if missing > 0 and not builder.contents.losses:
        what = f"count {summary.statistics.message_count} messages, {missing} more than are in the file"
        builder.contents.losses.append(Loss("the statistics", what, None))
