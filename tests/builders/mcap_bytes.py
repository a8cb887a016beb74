"""MCAP files byte by byte: records of any content, and where those of a file lie."""

import struct
import zlib
from collections.abc import Iterator

from mcap.opcode import Opcode

from jiti.episodes.mcap_records import MAGIC


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
