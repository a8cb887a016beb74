"""ROS 2 messages: their definitions (`ros2msg` schemas) and where their fields lie in CDR bytes.

Definitions: https://mcap.dev/spec/registry#ros2msg. Bytes: OMG CDR, 4 bytes of encapsulation and then the fields, each
aligned to its size (to 4 bytes at most in XCDR2), counted from the end of the encapsulation.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jiti.episodes.mcap_layout import Blob, Fixed, Number, Numbers, Text, Tree, Undecodable

PRIMITIVES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "u2",
    "int16": "i2",
    "uint32": "u4",
    "int32": "i4",
    "uint64": "u8",
    "int64": "i8",
    "float32": "f4",
    "float64": "f8",
}
BYTES = ("byte", "char", "uint8")
"""Sequences of these are pictures, point clouds and the like: blobs, not numbers."""
TIME = "int32 sec\nuint32 nanosec"
MAX_DEPTH = 32
"""Messages inside messages. Our choice: a schema that contains itself must end."""

_FIELD = re.compile(r"([A-Za-z]\w*(?:/\w+)*)(<=\d+)?(\[(<=)?(\d*)\])?\s+(\w+)\s*(=?)")
_SEPARATOR = re.compile(r"^={3,}\s*$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a definition."""

    name: str
    type: str
    """A primitive, `string`, `wstring`, or `package/Name`."""
    array: bool = False
    length: int | None = None
    """Of a fixed array; None for a sequence."""


def definitions(schema_name: str, text: str) -> dict[str, tuple[Field, ...]]:
    """Definitions by `package/Name` from the text of a ros2msg schema. Raises Undecodable."""
    found = {"builtin_interfaces/Time": _fields(TIME, ""), "builtin_interfaces/Duration": _fields(TIME, "")}
    name = schema_name
    for part in _SEPARATOR.split(text):
        if match := re.search(r"^MSG:\s+(\S+)\s*$", part, re.MULTILINE):
            name = match.group(1)
            part = part.replace(match.group(0), "")
        short = _short(name)
        found[short] = _fields(part, short.split("/")[0])
    return found


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else name


def _fields(text: str, package: str) -> tuple[Field, ...]:
    fields = []
    for line in text.splitlines():
        line = line.split("#")[0].strip()
        if not line:
            continue
        match = _FIELD.match(line)
        if match is None:
            raise Undecodable(f"the schema has a line that is no field: {line[:80]!r}")
        kind, _, array, bound, length, name, constant = match.groups()
        if constant:
            continue
        if kind == "Header":  # ROS 1's short name, which some converters leave in
            kind = "std_msgs/Header"
        elif kind not in PRIMITIVES and kind not in ("string", "wstring"):
            kind = _short(kind) if "/" in kind else f"{package}/{kind}"
        fields.append(Field(name, kind, array is not None, int(length) if length and not bound else None))
    return tuple(fields)


class CdrParser:
    """Where the fields of one ROS 2 type lie."""

    vectorized = True

    def __init__(self, schema_name: str, text: str) -> None:
        self._definitions = definitions(schema_name, text)
        self._name = _short(schema_name)
        if self._name not in self._definitions:
            raise Undecodable(f"the schema does not define {schema_name}")
        _check(self._definitions, self._name, ())

    def parse(self, block: bytes, start: int, end: int) -> tuple[Tree, list[Fixed]]:
        if end - start < 4:
            raise Undecodable(f"it has {end - start} bytes, fewer than the 4 of the CDR header")
        kind = block[start + 1]
        if kind > 7 or block[start]:
            raise Undecodable(f"its CDR encapsulation 0x{block[start]:02x}{kind:02x} is not supported")
        walk = _Walk(self._definitions, block, start, end, "<" if kind & 1 else ">", 4 if kind >= 6 else 8)
        tree = walk.message(self._name)
        return tree, walk.fixed


def _check(known: Mapping[str, tuple[Field, ...]], name: str, path: tuple[str, ...]) -> None:
    """Refuse a schema that lacks a definition or never ends. Raises Undecodable."""
    if name in path or len(path) > MAX_DEPTH:
        raise Undecodable(f"the schema's {name} contains itself")
    if name not in known:
        raise Undecodable(f"the schema does not define {name}")
    for field in known[name]:
        if field.type not in PRIMITIVES and field.type not in ("string", "wstring"):
            _check(known, field.type, (*path, name))


class _Walk:
    """One pass over one message."""

    def __init__(
        self, known: Mapping[str, tuple[Field, ...]], block: bytes, start: int, end: int, order: str, align: int
    ) -> None:
        self._known = known
        self._block = block
        self._origin = start + 4
        self._position = start + 4
        self._end = end
        self._order = order
        self._align = align
        self._length = struct.Struct(f"{order}I")
        self.fixed = [Fixed(start, 2)]

    def message(self, name: str) -> dict[str, Any]:
        fields = self._known[name]
        if not fields:
            self._take(1, 1)  # ROS 2 writes a byte for a message without fields
        return {field.name: self._field(field) for field in fields}

    def _take(self, size: int, count: int) -> int:
        """Skip `count` numbers of `size` bytes; returns where the first is."""
        align = min(size, self._align)
        offset = self._position + (self._origin - self._position) % align if count else self._position
        self._position = offset + size * count
        if self._position > self._end:
            raise Undecodable(f"it ends after {self._end - self._origin} bytes, inside one of its fields")
        return offset

    def _count(self) -> int:
        offset = self._take(4, 1)
        self.fixed.append(Fixed(offset, 4))
        count = self._length.unpack_from(self._block, offset)[0]
        if count > self._end - self._position:
            raise Undecodable(f"it declares {count} elements and has {self._end - self._position} bytes left")
        return count

    def _text(self) -> Text:
        length = self._count()
        offset = self._take(1, length)
        data = self._block[offset : offset + length].rstrip(b"\0")
        return Text(offset, length, data.decode("utf-8", "replace"))

    def _field(self, field: Field) -> Any:
        if not field.array:
            return self._one(field.type)
        count = self._count() if field.length is None else field.length
        code = PRIMITIVES.get(field.type)
        if code is None:
            if count > self._end - self._position:
                raise Undecodable(f"it declares {count} elements and has {self._end - self._position} bytes left")
            return [self._one(field.type) for _ in range(count)]
        offset = self._take(int(code[1]), count)
        if field.length is None and field.type in BYTES:
            return Blob(offset, count)
        return Numbers(offset, self._order + code, count)

    def _one(self, kind: str) -> Any:
        if code := PRIMITIVES.get(kind):
            return Number(self._take(int(code[1]), 1), self._order + code)
        if kind == "string":
            return self._text()
        if kind == "wstring":
            raise Undecodable("it has a wstring, which is not supported")
        return self.message(kind)
