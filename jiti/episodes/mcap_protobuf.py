"""Protobuf messages: where their fields lie on the wire.

Encoding: https://protobuf.dev/programming-guides/encoding. A field that has its default is not on the wire at all:
it is a constant here, unless its absence means something (`optional`, messages).
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from jiti.episodes.mcap_layout import Blob, Fixed, Number, Numbers, Text, Tree, Undecodable

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
MAX_DEPTH = 100
"""Messages inside messages. The limit of Google's own parsers."""

_F = FieldDescriptor
_FIXED_CODES = {
    _F.TYPE_DOUBLE: "<f8",
    _F.TYPE_FLOAT: "<f4",
    _F.TYPE_FIXED64: "<u8",
    _F.TYPE_FIXED32: "<u4",
    _F.TYPE_SFIXED64: "<i8",
    _F.TYPE_SFIXED32: "<i4",
}
_VARINT_CODES = {
    _F.TYPE_INT32: "signed",
    _F.TYPE_INT64: "signed",
    _F.TYPE_ENUM: "signed",
    _F.TYPE_UINT32: "unsigned",
    _F.TYPE_UINT64: "unsigned",
    _F.TYPE_BOOL: "unsigned",
    _F.TYPE_SINT32: "zigzag",
    _F.TYPE_SINT64: "zigzag",
}


class ProtobufParser:
    """Where the fields of one Protobuf type lie."""

    vectorized = True

    def __init__(self, schema: Schema) -> None:
        try:
            decode = DecoderFactory().decoder_for("protobuf", schema)
            if decode is None:
                raise Undecodable(f"the schema of {schema.name} is not Protobuf")
            self._descriptor: Descriptor = decode(b"").DESCRIPTOR
        except (McapError, DecodeError, TypeError, KeyError, ValueError, RecursionError) as error:
            raise Undecodable(f"the schema of {schema.name} cannot be read ({error})") from error

    def parse(self, block: bytes, start: int, end: int) -> tuple[Tree, list[Fixed]]:
        fixed: list[Fixed] = []
        return _message(self._descriptor, block, start, end, fixed, 0), fixed


def _varint(block: bytes, position: int, end: int) -> tuple[int, int]:
    """A varint and the position after it."""
    value = shift = 0
    while position < end and shift < 70:
        byte = block[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
    raise Undecodable("a number in it does not end")


def _message(
    descriptor: Descriptor, block: bytes, start: int, end: int, fixed: list[Fixed], depth: int
) -> dict[str, Any]:
    if depth > MAX_DEPTH:
        raise Undecodable(f"it has messages more than {MAX_DEPTH} deep")
    tree: dict[str, Any] = {}
    fields = descriptor.fields_by_number
    position = start
    while position < end:
        tag, after = _varint(block, position, end)
        fixed.append(Fixed(position, after - position))
        field, wire = fields.get(tag >> 3), tag & 7
        if wire == VARINT:
            _, position = _varint(block, after, end)
            fixed.append(Fixed(after, position - after, 0x80))
        elif wire == LENGTH:
            length, at = _varint(block, after, end)
            fixed.append(Fixed(after, at - after))
            after, position = at, at + length
        elif wire in (FIXED64, FIXED32):
            position = after + (8 if wire == FIXED64 else 4)
        else:
            raise Undecodable(f"it has wire type {wire}, which is not supported")
        if position > end or tag >> 3 == 0:
            raise Undecodable(f"field {tag >> 3} runs past its end")
        if field is not None:
            _put(tree, field, _value(field, wire, block, after, position, fixed, depth))
    for field in descriptor.fields:
        if field.name not in tree:
            _default(tree, field)
    return {field.name: tree[field.name] for field in descriptor.fields if field.name in tree}


def _value(
    field: FieldDescriptor, wire: int, block: bytes, start: int, end: int, fixed: list[Fixed], depth: int
) -> Any:
    """What `block[start:end]` is; None when the wire type is not one that the field can have."""
    kind = field.type
    if wire == LENGTH:
        if field.message_type is not None:
            return _message(field.message_type, block, start, end, fixed, depth + 1)
        if kind == _F.TYPE_STRING:
            return Text(start, end - start, block[start:end].decode("utf-8", "replace"))
        if kind == _F.TYPE_BYTES:
            return Blob(start, end - start)
        return _packed(kind, block, start, end, fixed)
    if wire == VARINT and kind in _VARINT_CODES:
        return Number(start, _VARINT_CODES[kind], end - start)
    code = _FIXED_CODES.get(kind)
    return Number(start, code) if code and np.dtype(code).itemsize == end - start else None


def _packed(kind: int, block: bytes, start: int, end: int, fixed: list[Fixed]) -> Numbers | list[Number] | None:
    if code := _FIXED_CODES.get(kind):
        count, rest = divmod(end - start, np.dtype(code).itemsize)
        if rest:
            raise Undecodable("it has a packed field of a wrong length")
        return Numbers(start, code, count)
    if kind not in _VARINT_CODES:
        return None
    numbers, position = [], start
    while position < end:
        _, after = _varint(block, position, end)
        numbers.append(Number(position, _VARINT_CODES[kind], after - position))
        position = after
    fixed.append(Fixed(start, end - start, 0x80))
    return numbers


def _put(tree: dict[str, Any], field: FieldDescriptor, value: Any) -> None:
    if value is None:
        return
    if not field.is_repeated:
        tree[field.name] = value  # the last one counts, as in Google's parsers
        return
    before = tree.get(field.name)
    if before is None and isinstance(value, Numbers):
        tree[field.name] = value
        return
    many: list[Any] = before.split() if isinstance(before, Numbers) else (before or [])
    many.extend(_elements(value))
    tree[field.name] = many


def _elements(value: Any) -> Iterable[Any]:
    if isinstance(value, Numbers):
        return value.split()
    return value if isinstance(value, list) else [value]


def _default(tree: dict[str, Any], field: FieldDescriptor) -> None:
    if field.is_repeated:
        tree[field.name] = []
    elif not field.has_presence:
        if field.type == _F.TYPE_STRING:
            tree[field.name] = Text(0, 0, "")
        elif field.type == _F.TYPE_BYTES:
            tree[field.name] = Blob(0, 0)
        else:
            tree[field.name] = Number(0, "constant", 0, float(field.default_value))
