"""One pass over the chunks of an MCAP recording, each unpacked once, that yields the wanted streams in batches."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from mcap.opcode import Opcode

from jiti.episodes.episode import Batch, ImageBatch, NumericBatch
from jiti.episodes.mcap_contents import Contents
from jiti.episodes.mcap_layout import Undecodable
from jiti.episodes.mcap_numbers import NumberDecoder
from jiti.episodes.mcap_pictures import Picture, PictureDecoder
from jiti.episodes.mcap_records import (
    MESSAGE_HEAD,
    MESSAGE_RECORD,
    RECORD,
    McapFile,
    RecordDamaged,
    message_heads,
    unpack,
)
from jiti.episodes.mcap_streams import McapStream
from jiti.errors import SourceError


@dataclass(slots=True)
class Fault:
    """Messages of one stream that something is wrong with."""

    count: int
    index: int
    """The first of them, in the stream's order."""
    reason: str


@dataclass(slots=True)
class Faults:
    """What a pass found wrong."""

    chunks: dict[int, str] = field(default_factory=dict)
    """Chunks that cannot be unpacked, with the reason."""
    left_out: dict[str, Fault] = field(default_factory=dict)
    """By stream: messages that were left out."""
    other_format: dict[str, Fault] = field(default_factory=dict)
    """By stream: pictures whose bytes are not what the message declares."""
    missing: dict[str, str] = field(default_factory=dict)
    """By stream: a component that some message lacks."""
    unknown: dict[str, str] = field(default_factory=dict)
    """By stream: a component that some message has and the stream does not declare."""


def _note(faults: dict[str, Fault], stream: str, index: int, reason: str, count: int = 1) -> None:
    known = faults.get(stream)
    if known is None:
        faults[stream] = Fault(count, index, reason)
    else:
        known.count += count
        if index < known.index:
            known.index, known.reason = index, reason


class _Reader:
    """One wanted stream during a pass."""

    def __init__(self, stream: McapStream, faults: Faults) -> None:
        self.stream = stream
        self._faults = faults
        by_chunk = np.argsort(stream.rows.chunk, kind="stable")
        numbers = stream.rows.chunk[by_chunk]
        starts = np.flatnonzero(np.diff(numbers, prepend=-1))
        parts = np.split(by_chunk, starts[1:]) if len(starts) else []
        self.chunks: dict[int, np.ndarray] = dict(zip(numbers[starts].tolist(), parts, strict=True))
        """By chunk: its rows, growing."""
        self._limits: list[int] = []
        """By visit, last first: the smallest row of all chunks that come after it."""

    def plan(self, visits: Sequence[int]) -> None:
        """Learn in which order the chunks will come, to know what may be given out after each."""
        smallest = len(self.stream.time_ns)
        for number in reversed(visits):
            self._limits.append(smallest)
            if number in self.chunks:
                smallest = min(smallest, int(self.chunks[number][0]))

    def take(self, number: int, block: bytes | None) -> Iterator[Batch]:
        """Batches that can be given out once chunk `number` is there; `block` is None when it is corrupt."""
        limit = self._limits.pop()
        if block is not None and number in self.chunks:
            self._decode(block, *self._locate(block, self.chunks[number]))
        yield from self._give(limit)

    def _decode(self, block: bytes, rows: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> None:
        """Take in the messages `block[start:end]`, which are `rows` of the stream."""
        raise NotImplementedError

    def _give(self, limit: int) -> Iterator[Batch]:
        """Give out what was taken in and stands before row `limit`."""
        raise NotImplementedError

    def _locate(self, block: bytes, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows whose message is where the index says, and the start and end of each payload."""
        offsets = self.stream.rows.offset[rows]
        inside = offsets + MESSAGE_RECORD.itemsize <= len(block)
        good = inside.copy()
        heads = message_heads(block, offsets[inside])
        # Lengths are unsigned and may be anything; compare before they become offsets.
        fits = (heads["length"] >= MESSAGE_HEAD.size) & (heads["length"] <= np.uint64(len(block)))
        ends = offsets[inside] + RECORD.size + np.where(fits, heads["length"], 0).astype(np.int64)
        known = np.zeros(len(heads), bool)
        for channel in self.stream.channels:
            known |= heads["channel"] == channel
        known &= heads["op"] == Opcode.MESSAGE
        known &= heads["log"] == self.stream.rows.time_ns[rows[inside]].astype(np.uint64)
        right = fits & known & (ends <= len(block))
        good[inside] = right
        for row in rows[~good].tolist():
            _note(self._faults.left_out, self.stream.name, row, "the message index points to something else")
        return rows[good], offsets[good] + MESSAGE_RECORD.itemsize, ends[right]


class _PictureReader(_Reader):
    """Pictures of one stream."""

    def __init__(self, stream: McapStream, faults: Faults, decoder: PictureDecoder) -> None:
        super().__init__(stream, faults)
        self._decoder = decoder
        self._held: list[tuple[int, Picture]] = []

    def _decode(self, block: bytes, rows: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> None:
        in_order = not self._held
        for row, start, end in zip(rows.tolist(), starts.tolist(), ends.tolist(), strict=True):
            try:
                picture = self._decoder.decode(block, start, end)
            except Undecodable as error:
                _note(self._faults.left_out, self.stream.name, row, str(error))
                continue
            if picture.declared is not None:
                what = f"{picture.encoding.upper()} and declared as {picture.declared!r}"
                _note(self._faults.other_format, self.stream.name, row, what)
            self._held.append((row, picture))
        if not in_order:
            self._held.sort(key=lambda item: item[0])

    def _give(self, limit: int) -> Iterator[Batch]:
        if not self._held or self._held[0][0] >= limit:
            return
        ready = self._held if self._held[-1][0] < limit else [item for item in self._held if item[0] < limit]
        self._held = self._held[len(ready) :]
        for (encoding, raw), group in groupby(ready, key=lambda item: (item[1].encoding, item[1].raw)):
            items = list(group)
            times = self.stream.time_ns[[row for row, _ in items]]
            yield ImageBatch(self.stream.name, times, [picture.data for _, picture in items], encoding, raw)


class _NumberReader(_Reader):
    """Numbers of one stream."""

    def __init__(self, stream: McapStream, faults: Faults, decoder: NumberDecoder) -> None:
        super().__init__(stream, faults)
        self._decoder = decoder
        self._rows = np.empty(0, np.int64)
        self._values = np.empty((0, len(stream.names)))

    def _decode(self, block: bytes, rows: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> None:
        failures: dict[int, str] = {}
        good, values = self._decoder.decode(block, starts, ends, failures)
        for index, reason in failures.items():
            _note(self._faults.left_out, self.stream.name, int(rows[index]), reason)
        if self._decoder.missing:
            self._faults.missing[self.stream.name] = self._decoder.missing
        if self._decoder.unknown:
            self._faults.unknown[self.stream.name] = self._decoder.unknown
        if not len(self._rows):
            self._rows, self._values = rows[good], values
            return
        rows = np.concatenate([self._rows, rows[good]])
        order = np.argsort(rows, kind="stable")
        self._rows, self._values = rows[order], np.concatenate([self._values, values])[order]

    def _give(self, limit: int) -> Iterator[Batch]:
        count = int(np.searchsorted(self._rows, limit))
        if count:
            yield NumericBatch(self.stream.name, self.stream.time_ns[self._rows[:count]], self._values[:count])
            self._rows, self._values = self._rows[count:], self._values[count:]


def _reader(stream: McapStream, faults: Faults) -> _Reader:
    parser, picture = stream.reading.parser, stream.reading.picture
    if parser is None:
        raise SourceError(f"{stream.name} cannot be read: {stream.reading.unsupported}.")
    if picture is not None:
        return _PictureReader(stream, faults, PictureDecoder(parser, picture))
    return _NumberReader(stream, faults, NumberDecoder(parser, stream.names))


def read_streams(file: McapFile, contents: Contents, streams: Iterable[McapStream], faults: Faults) -> Iterator[Batch]:
    """Yield batches of the streams; times within a stream never go back.

    Chunks are visited in order of the earliest wanted message in each, so that little is held back where chunks
    overlap in time. Unpacking the next chunk on a second thread was measured and gained nothing: zstd and the CRC take
    a sixth of a read.
    """
    readers = [_reader(stream, faults) for stream in streams]
    earliest: dict[int, int] = {}
    for reader in readers:
        for number, rows in reader.chunks.items():
            first = int(reader.stream.time_ns[rows[0]])
            earliest[number] = min(first, earliest.get(number, first))
    visits = sorted(earliest, key=lambda number: (earliest[number], number))
    for reader in readers:
        reader.plan(visits)
    for number in visits:
        block = None
        try:
            block = unpack(file, contents.chunks[number])
        except RecordDamaged as error:
            faults.chunks[number] = str(error)
        for reader in readers:
            yield from reader.take(number, block)
