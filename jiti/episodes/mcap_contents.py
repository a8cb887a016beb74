"""The table of contents of an MCAP file: its channels, its chunks, and where each message lies."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema

from jiti.episodes.mcap_records import (
    MESSAGE_HEAD,
    MESSAGE_RECORD,
    RECORD,
    Chunk,
    McapFile,
    RecordDamaged,
    parse,
    records,
    unpack,
)

ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
"""One message in a message index: log time, and offset of its record into the unpacked chunk."""
LATEST_NS = np.iinfo(np.int64).max
"""Log times are unsigned in the format and signed here: up to the year 2262."""
METADATA_NAME = "jiti"
"""Name of the metadata records that jiti's own recorders write: the instruction, the task's id."""
MAX_METADATA_BYTES = 16 << 20
"""Largest metadata record that is read. Our choice: a task or a calibration takes a few kilobytes."""

COPY_AGAIN = "Go on with what could be read, or copy the recording from its source again"


@dataclass(frozen=True, slots=True)
class Rows:
    """The messages of one channel in recording order."""

    time_ns: np.ndarray
    """(N,) int64 log times."""
    chunk: np.ndarray
    """(N,) int32 number of the chunk."""
    offset: np.ndarray
    """(N,) int64 offset of the message's record into the unpacked chunk."""


@dataclass(frozen=True, slots=True)
class Loss:
    """Part of a file that cannot be had, as exactly as it is known."""

    where: str
    """`channel 3`; of a chunk, its place: `at byte 123456`."""
    what: str
    """`is corrupt (CRC mismatch)`."""
    counts: Mapping[int, int] | None = None
    """Messages lost a channel; None when there is no telling; empty when none are."""
    first_ns: int | None = None
    last_ns: int | None = None
    chunk: int | None = None
    """Number of the chunk, where it is all of one."""
    remedy: str = COPY_AGAIN


@dataclass(slots=True)
class Contents:
    """What is in a file, and what is lost of it."""

    size_bytes: int
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    rows: dict[int, Rows] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    profile: str = ""


class ContentsBuilder:
    """Collects a table of contents from a file's records."""

    def __init__(self, file: McapFile) -> None:
        self.file = file
        self.contents = Contents(file.size)
        self._pieces: dict[int, list[tuple[int, bytes]]] = defaultdict(list)
        """By channel: (chunk number, ENTRY records)."""

    def define(self, opcode: int, content: bytes) -> None:
        """Take a record that stands outside of messages: header, schema, channel or metadata. Raises RecordDamaged."""
        contents = self.contents
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, content)
            if contents.schemas.setdefault(schema.id, schema) != schema:
                self._defined_twice("schema", schema.id)
        elif opcode == Opcode.CHANNEL:
            channel = parse(Channel, content)
            if contents.channels.setdefault(channel.id, channel) != channel:
                self._defined_twice("channel", channel.id)
        elif opcode == Opcode.METADATA:
            contents.metadata.append(parse(Metadata, content))
        elif opcode == Opcode.HEADER:
            contents.profile = parse(Header, content).profile

    def define_or_lose(self, opcode: int, content: bytes, where: str) -> None:
        """Take a definition, or add it to the losses."""
        try:
            self.define(opcode, content)
        except RecordDamaged as error:
            self.contents.losses.append(Loss(where, f"is corrupt ({error})", {}))

    def _defined_twice(self, what: str, number: int) -> None:
        loss = Loss(f"{what} {number}", "is defined twice, differently; the first definition is used", {})
        if loss not in self.contents.losses:
            self.contents.losses.append(loss)

    def add(self, chunk: Chunk) -> None:
        self.contents.chunks.append(chunk)

    def add_entries(self, number: int, entries: Mapping[int, bytes]) -> None:
        """Messages of a chunk by channel, each as ENTRY records."""
        for channel, piece in entries.items():
            self._pieces[channel].append((number, piece))

    def scan(self, chunk: Chunk) -> dict[int, bytes]:
        """Unpack a chunk, take its definitions and list its messages as ENTRY records. Raises RecordDamaged."""
        block = unpack(self.file, chunk)
        entries: dict[int, list[int]] = defaultdict(list)
        definitions = []
        for opcode, start, end in records(block, cut_short=chunk.cut_short):
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(block, start)
                entries[channel] += (log_time, start - RECORD.size)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                definitions.append((opcode, block[start:end]))
        for opcode, content in definitions:
            self.define_or_lose(opcode, content, f"a record in chunk {chunk.number + 1}")
        return {channel: np.array(numbers, "<u8").tobytes() for channel, numbers in entries.items()}

    def scan_all(self, chunks: list[Chunk]) -> None:
        """Replace what is known of the messages of all chunks by what is in them."""
        self._pieces.clear()
        for chunk in chunks:
            self.scan_into(chunk)

    def scan_into(self, chunk: Chunk) -> None:
        """Take the messages of a chunk, or add it to the losses."""
        try:
            self.add_entries(chunk.number, self.scan(chunk))
        except RecordDamaged as error:
            self.contents.losses.append(lost_with(chunk, str(error), None))

    def counts(self) -> dict[int, int]:
        """Messages a channel so far."""
        return {c: sum(len(piece) for _, piece in pieces) // ENTRY.itemsize for c, pieces in self._pieces.items()}

    def undefined(self) -> set[int]:
        """Channels that have messages and no definition yet."""
        return self._pieces.keys() - self.contents.channels.keys()

    def chunks_of(self, channel: int) -> list[int]:
        """Numbers of the chunks that hold messages of a channel."""
        return [number for number, _ in self._pieces[channel]]

    def finish(self) -> Contents:
        """The table, with messages that no one can use counted among the losses."""
        contents = self.contents
        for channel in sorted(self._pieces):
            pieces = self._pieces[channel]
            entries = np.frombuffer(b"".join(piece for _, piece in pieces), ENTRY)
            numbers = np.repeat(
                np.array([number for number, _ in pieces], np.int32),
                [len(piece) // ENTRY.itemsize for _, piece in pieces],
            )
            if channel not in contents.channels:
                first, last = (int(t) for t in (entries["time"].min(), entries["time"].max()))
                what = "has messages, and what it is was lost with another part of the file"
                contents.losses.append(Loss(f"channel {channel}", what, {channel: len(entries)}, first, last))
                continue
            good = entries["time"] <= LATEST_NS
            if not good.all():
                where, lost = f"channel {channel}", int((~good).sum())
                contents.losses.append(Loss(where, "has log times after the year 2262", {channel: lost}))
            rows = Rows(entries["time"][good].astype(np.int64), numbers[good], entries["offset"][good].astype(np.int64))
            contents.rows[channel] = _in_recording_order(rows)
        return contents


def _in_recording_order(rows: Rows) -> Rows:
    chunk_steps, offset_steps = np.diff(rows.chunk), np.diff(rows.offset)
    if ((chunk_steps > 0) | ((chunk_steps == 0) & (offset_steps > 0))).all():
        return rows
    order = np.lexsort((rows.offset, rows.chunk))
    chunk, offset = rows.chunk[order], rows.offset[order]
    once = np.ones(len(order), bool)
    once[1:] = (np.diff(chunk) != 0) | (np.diff(offset) != 0)
    return Rows(rows.time_ns[order][once], chunk[once], offset[once])


def fits(entries: Mapping[int, bytes], chunk: Chunk, first_ns: int, last_ns: int) -> bool:
    """Whether a message index can be that of a chunk: its times and offsets lie inside the chunk's."""
    every = np.frombuffer(b"".join(entries.values()), ENTRY)
    if not len(every):
        return chunk.unpacked_size == 0
    times, offsets = every["time"], every["offset"]
    inside = chunk.unpacked_size >= MESSAGE_RECORD.itemsize
    inside = inside and bool(offsets.max() <= chunk.unpacked_size - MESSAGE_RECORD.itemsize)
    return inside and bool(first_ns <= times.min()) and bool(times.max() <= last_ns)


def lost_with(chunk: Chunk, reason: str, entries: Mapping[int, bytes] | None) -> Loss:
    """The loss of a whole chunk, counted by its message index where there is one."""
    loss = Loss(f"at byte {chunk.offset}", f"is corrupt ({reason})", chunk=chunk.number)
    if not entries:
        return loss
    every = np.frombuffer(b"".join(entries.values()), ENTRY)
    counts = {channel: len(piece) // ENTRY.itemsize for channel, piece in entries.items()}
    return replace(loss, counts=counts, first_ns=int(every["time"].min()), last_ns=int(every["time"].max()))
