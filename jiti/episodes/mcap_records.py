"""Bytes of an MCAP file: its records, its chunks and what is in them, checked before anything is believed.

Format: https://mcap.dev/spec. Numbers are little-endian; a record is an opcode (1 byte), the length of its
content (8 bytes) and the content.
"""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from jiti.errors import SourceError

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""Opcode and length of content, before every record."""
CHUNK_HEAD = struct.Struct("<QQQII")
"""First and last log time, unpacked size, CRC, length of the compression's name."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, log time, publish time; the payload follows."""
MESSAGE_RECORD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""RECORD and MESSAGE_HEAD in one, 31 bytes."""

MAX_UNPACKED_BYTES = 1 << 30
"""Largest chunk that is unpacked. Our choice: recorders write 1 to 16 MiB; a zstd chunk can claim anything."""
MAX_COMPRESSION_NAME = 64
"""Longest name of a compression, in bytes, that is read. Our choice: "zstd" and "lz4" are those of the format."""


class RecordDamaged(SourceError):
    """A record or a chunk is not what it says it is; the message says how, without the place."""


class Readable[T](Protocol):
    """A record class of the mcap library."""

    @staticmethod
    def read(stream: ReadDataStream) -> T: ...


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a run of records lies: a chunk, or messages that stand in the file without one."""

    number: int
    """From 0 in the file's order."""
    offset: int
    """Of the chunk's record, or of the first record of the run."""
    data_offset: int
    stored_size: int
    """Bytes at `data_offset`."""
    unpacked_size: int
    compression: str
    crc: int
    """Of the unpacked bytes; 0 when there is none."""
    cut_short: bool = False
    """The file ends inside it: what comes before the end counts, and there is no telling its CRC."""


class McapFile:
    """Positioned reads that never run past the end of the file unnoticed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise SourceError(f"{path} cannot be read: {reason}. Check the path and its permissions.") from error
        status = os.fstat(self._descriptor)
        self.size = status.st_size
        self.stamp = (status.st_size, status.st_mtime_ns, status.st_ino)
        """Another one when the file was written to or replaced."""

    def __enter__(self) -> "McapFile":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        os.close(self._descriptor)

    def read(self, offset: int, length: int) -> bytes:
        """Exactly `length` bytes. Raises RecordDamaged when the file has fewer, before anything is allocated."""
        if offset < 0 or length < 0 or offset + length > self.size:
            raise RecordDamaged(f"{length} bytes at byte {offset} run past the end of the file at byte {self.size}")
        try:
            data = os.pread(self._descriptor, length, offset)
            while len(data) < length and (more := os.pread(self._descriptor, length - len(data), offset + len(data))):
                data += more
        except OSError as error:
            raise SourceError(
                f"{self.path} cannot be read at byte {offset}: {(error.strerror or str(error)).lower()}. "
                "Check the disk and copy the recording again."
            ) from error
        if len(data) < length:
            raise RecordDamaged(f"the file became shorter than {offset + length} bytes while it was read")
        return data

    def record(self, offset: int) -> tuple[int, int]:
        """Opcode and length of content of the record at `offset`."""
        return RECORD.unpack(self.read(offset, RECORD.size))


def parse[T](record: type[Readable[T]], content: bytes) -> T:
    """A record by the mcap library's own class. Raises RecordDamaged."""
    try:
        return record.read(ReadDataStream(io.BytesIO(content)))
    except (McapError, struct.error, ValueError) as error:
        raise RecordDamaged(f"a {record.__name__} record cannot be read ({error or type(error).__name__})") from error


def chunk_at(file: McapFile, number: int, offset: int, length: int) -> Chunk:
    """The chunk whose record at `offset` has `length` bytes of content; the file may end inside it.

    Raises RecordDamaged when its head does not fit the record.
    """
    start = offset + RECORD.size
    cut_short = start + length > file.size
    available = min(length, file.size - start)
    head = file.read(start, min(available, CHUNK_HEAD.size + MAX_COMPRESSION_NAME + 8))
    if len(head) < CHUNK_HEAD.size:
        raise RecordDamaged("the head of the chunk is incomplete")
    _, _, unpacked, crc, name_length = CHUNK_HEAD.unpack_from(head)
    if name_length > MAX_COMPRESSION_NAME:
        raise RecordDamaged(f"the name of its compression would be {name_length} bytes long")
    name_end = CHUNK_HEAD.size + name_length
    if len(head) < name_end + 8:
        raise RecordDamaged("the head of the chunk is incomplete")
    name = head[CHUNK_HEAD.size : name_end].decode("utf-8", "replace")
    stored = int.from_bytes(head[name_end : name_end + 8], "little")
    if stored > length - name_end - 8:
        raise RecordDamaged(f"it claims {stored} bytes of records, and its record has {length - name_end - 8}")
    size = min(stored, available - name_end - 8)
    return Chunk(number, offset, start + name_end + 8, size, unpacked, name, crc, cut_short and size < stored)


def check_unpackable(chunk: Chunk) -> None:
    """Refuse a chunk by what it declares. Raises RecordDamaged: unknown compression, a size over the limit."""
    if chunk.unpacked_size > MAX_UNPACKED_BYTES:
        raise RecordDamaged(f"it claims to unpack to {chunk.unpacked_size} bytes, the limit is {MAX_UNPACKED_BYTES}")
    if chunk.compression not in ("", "lz4", "zstd"):
        raise RecordDamaged(f"its compression {chunk.compression!r} is not known; known are zstd, lz4 and none")


def unpack(file: McapFile, chunk: Chunk) -> bytes:
    """The records of a chunk; of one that is cut short, those bytes that can still be had.

    Raises RecordDamaged with the reason, also for what `check_unpackable` refuses.
    """
    check_unpackable(chunk)
    stored = file.read(chunk.data_offset, chunk.stored_size)
    try:
        if chunk.compression == "zstd":
            data = _unpack_zstd(stored, chunk)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=chunk.unpacked_size + 1)
        else:
            data = stored
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise RecordDamaged(f"it does not decompress ({error})") from error
    if chunk.cut_short:
        return data[: chunk.unpacked_size]
    if len(data) != chunk.unpacked_size:
        more = "more than " if len(data) > chunk.unpacked_size else ""
        declared = f"the {chunk.unpacked_size} that it declares"
        raise RecordDamaged(f"it unpacks to {more}{min(len(data), chunk.unpacked_size)} bytes instead of {declared}")
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise RecordDamaged("CRC mismatch")
    return data


def _unpack_zstd(stored: bytes, chunk: Chunk) -> bytes:
    if chunk.cut_short:
        return zstandard.ZstdDecompressor().stream_reader(io.BytesIO(stored)).read(chunk.unpacked_size)
    declared = zstandard.frame_content_size(stored) if stored else 0
    if declared not in (-1, chunk.unpacked_size):
        raise RecordDamaged(f"it holds {declared} bytes instead of the {chunk.unpacked_size} that it declares")
    if not chunk.unpacked_size:
        return b""
    return zstandard.ZstdDecompressor().decompress(stored, max_output_size=chunk.unpacked_size)


def records(block: bytes, *, cut_short: bool = False) -> Iterator[tuple[int, int, int]]:
    """Yield `(opcode, start, end)` of the content of each record in a block.

    Raises RecordDamaged when one runs past the end, unless the block is known to be cut short.
    """
    position, size = 0, len(block)
    while position < size:
        if position + RECORD.size > size:
            break
        opcode, length = RECORD.unpack_from(block, position)
        start = position + RECORD.size
        if start + length > size or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size):
            break
        yield opcode, start, start + length
        position = start + length
    if position < size and not cut_short:
        raise RecordDamaged(f"the record at byte {position} of its {size} unpacked bytes runs past their end")


def message_heads(block: bytes, offsets: np.ndarray) -> np.ndarray:
    """Heads of the message records at `offsets` (N,) into a block: (N,) of MESSAGE_RECORD.

    The offsets must leave room for a head; what is there is for the caller to check.
    """
    positions = offsets.astype(np.int64)[:, None] + np.arange(MESSAGE_RECORD.itemsize)
    return np.frombuffer(block, np.uint8)[positions].reshape(-1).view(MESSAGE_RECORD)
