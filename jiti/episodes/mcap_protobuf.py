"""Protobuf messages: where their fields lie on the wire.

Encoding: https://protobuf.dev/programming-guides/encoding. A field that has its default is not on the wire at all:
it is a constant here, unless its absence means something (`optional`, messages).
"""

from dataclasses import dataclass, field
from typing import Any

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


@dataclass(frozen=True, slots=True)
class _Field:
    """What the walk needs of a field; asking the descriptor each time takes most of a read."""

    name: str
    kind: int
    repeated: bool
    default: Any
    """None where absence means something."""
    message: "_Type | None" = None


@dataclass(slots=True)
class _Type:
    """A message type."""

    by_number: dict[int, _Field] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    """In the order of the definition."""


class ProtobufParser:
    """Where the fields of one Protobuf type lie."""

    vectorized = True

    def __init__(self, schema: Schema) -> None:
        try:
            decode = DecoderFactory().decoder_for("protobuf", schema)
            if decode is None:
                raise Undecodable(f"the schema of {schema.name} is not Protobuf")
            self._type = _type(decode(b"").DESCRIPTOR, {})
        except (McapError, DecodeError, TypeError, KeyError, ValueError, RecursionError) as error:
            raise Undecodable(f"the schema of {schema.name} cannot be read ({error})") from error

    def parse(self, block: bytes, start: int, end: int) -> tuple[Tree, list[Fixed]]:
        fixed: list[Fixed] = []
        return _message(self._type, block, start, end, fixed, 0), fixed


def _type(descriptor: Descriptor, known: dict[str, _Type]) -> _Type:
    """The type of a descriptor and of all that it contains, itself included."""
    if descriptor.full_name in known:
        return known[descriptor.full_name]
    made = known[descriptor.full_name] = _Type()
    for f in descriptor.fields:
        inner = _type(f.message_type, known) if f.message_type is not None else None
        default: Any = None
        if f.is_repeated:
            default = []
        elif not f.has_presence:
            default = _default(f)
        made.by_number[f.number] = _Field(f.name, f.type, f.is_repeated, default, inner)
        made.names.append(f.name)
    return made


def _default(f: FieldDescriptor) -> Text | Blob | Number:
    if f.type == _F.TYPE_STRING:
        return Text(0, 0, "")
    if f.type == _F.TYPE_BYTES:
        return Blob(0, 0)
    return Number(0, "constant", 0, float(f.default_value))


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


def _message(kind: _Type, block: bytes, start: int, end: int, fixed: list[Fixed], depth: int) -> dict[str, Any]:
    if depth > MAX_DEPTH:
        raise Undecodable(f"it has messages more than {MAX_DEPTH} deep")
    tree: dict[str, Any] = {}
    position = start
    while position < end:
        tag, after = _varint(block, position, end)
        fixed.append(Fixed(position, after - position))
        number, wire = tag >> 3, tag & 7
        if wire == LENGTH:
            length, at = _varint(block, after, end)
            fixed.append(Fixed(after, at - after))
            after, position = at, at + length
        elif wire == VARINT:
            _, position = _varint(block, after, end)
            fixed.append(Fixed(after, position - after, 0x80))
        elif wire in (FIXED64, FIXED32):
            position = after + (8 if wire == FIXED64 else 4)
        else:
            raise Undecodable(f"it has wire type {wire}, which is not supported")
        if position > end or not number:
            raise Undecodable(f"field {number} runs past its end")
        known = kind.by_number.get(number)
        if known is not None:
            value = _value(known, wire, block, after, position, fixed, depth)
            if known.repeated:
                _append(tree, known.name, value)
            elif value is not None:
                tree[known.name] = value  # the last one counts, as in Google's parsers
    for known in kind.by_number.values():
        if known.default is not None and known.name not in tree:
            tree[known.name] = known.default
    return {name: tree[name] for name in kind.names if name in tree}


def _value(known: _Field, wire: int, block: bytes, start: int, end: int, fixed: list[Fixed], depth: int) -> Any:
    """What `block[start:end]` is; None when the wire type is not one that the field can have."""
    if wire == LENGTH:
        if known.message is not None:
            return _message(known.message, block, start, end, fixed, depth + 1)
        if known.kind == _F.TYPE_BYTES:
            return Blob(start, end - start)
        if known.kind == _F.TYPE_STRING:
            return Text(start, end - start, block[start:end].decode("utf-8", "replace"))
        return _packed(known.kind, block, start, end, fixed) if known.repeated else None
    if wire == VARINT and known.kind in _VARINT_CODES:
        return Number(start, _VARINT_CODES[known.kind], end - start)
    code = _FIXED_CODES.get(known.kind)
    return Number(start, code) if code and int(code[2]) == end - start else None


def _packed(kind: int, block: bytes, start: int, end: int, fixed: list[Fixed]) -> Numbers | list[Number] | None:
    if code := _FIXED_CODES.get(kind):
        count, rest = divmod(end - start, int(code[2]))
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


def _append(tree: dict[str, Any], name: str, value: Any) -> None:
    """Add to a repeated field, which may come in several packed and single pieces."""
    if value is None:
        return
    before = tree.get(name)
    if before is None and isinstance(value, Numbers):
        tree[name] = value
        return
    many: list[Any] = before.split() if isinstance(before, Numbers) else (before or [])
    if isinstance(value, Numbers):
        many.extend(value.split())
    elif isinstance(value, list):
        many.extend(value)
    else:
        many.append(value)
    tree[name] = many
