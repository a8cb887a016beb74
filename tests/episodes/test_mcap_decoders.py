"""Where fields lie in CDR and Protobuf bytes, against the encoders of other people."""

import contextlib
import json
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Schema

from jiti.episodes.mcap_cdr import CdrParser
from jiti.episodes.mcap_components import Components
from jiti.episodes.mcap_decode import JsonParser
from jiti.episodes.mcap_layout import Blob, Number, Numbers, Parser, Text, Undecodable, layout_of
from jiti.episodes.mcap_numbers import NumberDecoder
from jiti.episodes.mcap_protobuf import ProtobufParser
from tests.builders import mcap_messages
from tests.builders.mcap_messages import HEADER, SEPARATOR, ros_payload

RANGES = {
    "bool": st.integers(0, 1),
    "int8": st.integers(-(2**7), 2**7 - 1),
    "uint8": st.integers(0, 2**8 - 1),
    "int16": st.integers(-(2**15), 2**15 - 1),
    "uint16": st.integers(0, 2**16 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "int64": st.integers(-(2**53), 2**53),
    "uint64": st.integers(0, 2**53),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
}
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


def plain(block: bytes, value: Any) -> Any:
    """A tree of places as plain values."""
    if isinstance(value, Number):
        layout = layout_of(block, 0, [], ("x",), [value])
        return layout.values(np.frombuffer(block, np.uint8)[None])[0, 0]
    if isinstance(value, Numbers):
        return [plain(block, number) for number in value.split()]
    if isinstance(value, Text):
        return value.text
    if isinstance(value, Blob):
        return block[value.offset : value.offset + value.length]
    if isinstance(value, list):
        return [plain(block, item) for item in value]
    return {key: plain(block, item) for key, item in value.items()}


@st.composite
def ros_messages(draw: st.DrawFn, depth: int = 0) -> tuple[list[str], list[str], dict[str, Any]]:
    """Lines of a definition, definitions that it needs, and a message as plain values."""
    lines: list[str] = []
    others: list[str] = []
    message: dict[str, Any] = {}
    for index in range(draw(st.integers(1, 5))):
        kind: str = draw(st.sampled_from([*RANGES, "string", *(["inner"] if depth < 2 else [])]))
        shape: str = draw(st.sampled_from(["one", "fixed", "sequence", "bounded"]))
        name = f"f{index}"
        if kind == "inner":
            inner, deeper, value = draw(ros_messages(depth + 1))
            type_name = f"P{depth}x{index}x{len(others)}{draw(st.integers(0, 10**9))}"
            others += [f"MSG: tests/{type_name}\n" + "\n".join(inner), *deeper]
            element = st.just(value)
        else:
            type_name = kind
            element = TEXTS if kind == "string" else RANGES[kind]
        count = draw(st.integers(1 if shape == "fixed" else 0, 4))
        suffix = {"one": "", "fixed": f"[{count}]", "sequence": "[]", "bounded": "[<=9]"}[shape]
        lines.append(f"{type_name}{suffix} {name}  # {index}")
        many = draw(st.lists(element, min_size=count, max_size=count))
        message[name] = draw(element) if shape == "one" else many
        if kind == "uint8" and shape in ("sequence", "bounded"):
            message[name] = bytes([int(item) for item in many])  # type: ignore[call-overload]
    return lines, others, message


def spaced(value: Any) -> Any:
    """Plain values as the objects that the ROS 2 encoder takes."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: spaced(item) for key, item in value.items()})
    return [spaced(item) for item in value] if isinstance(value, list) else value


@given(ros_messages())
def test_cdr_is_read_as_the_library_writes_it(made: tuple[list[str], list[str], dict[str, Any]]) -> None:
    lines, others, message = made
    text = SEPARATOR.join(["\n".join(lines), *others])
    data = ros_payload("tests/msg/Outer", spaced(message), text)
    block = b"\xaa" * 3 + data + b"\xbb"
    tree, _ = CdrParser("tests/msg/Outer", text).parse(block, 3, 3 + len(data))
    assert plain(block, tree) == message


@given(ros_messages(), st.data())
def test_cdr_that_is_cut_or_changed_is_refused_or_read_without_a_crash(made: tuple, data: st.DataObject) -> None:
    lines, others, message = made
    text = SEPARATOR.join(["\n".join(lines), *others])
    payload = bytearray(ros_payload("tests/msg/Outer", spaced(message), text))
    for _ in range(data.draw(st.integers(0, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(payload)))
    parser = CdrParser("tests/msg/Outer", text)
    with contextlib.suppress(Undecodable):
        Components(parser.parse(bytes(payload), 0, cut)[0])
    decode_all(parser, [bytes(payload[:cut])])


def test_big_endian_and_xcdr2() -> None:
    text = "uint8 a\nfloat64 b\n"
    little = struct.pack("<BBBBB7xd", 0, 1, 0, 0, 7, 2.5)
    big = struct.pack(">BBBBB7xd", 0, 0, 0, 0, 7, 2.5)
    second = struct.pack("<BBBBB3xd", 0, 7, 0, 0, 7, 2.5)  # XCDR2 aligns to 4 at most
    for data in (little, big, second):
        tree, _ = CdrParser("tests/msg/X", text).parse(data, 0, len(data))
        assert plain(data, tree) == {"a": 7, "b": 2.5}
    with pytest.raises(Undecodable, match="encapsulation 0x0009"):
        CdrParser("tests/msg/X", text).parse(b"\0\x09\0\0" + bytes(12), 0, 16)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("Other x\n", "does not define tests/Other"),
        ("X x\n", "contains itself"),
        ("float64\n", "no field"),
        ("Y y\n" + SEPARATOR + "MSG: tests/Y\nX x\n", "contains itself"),
    ],
)
def test_a_bad_definition_is_refused(text: str, reason: str) -> None:
    with pytest.raises(Undecodable, match=reason):
        CdrParser("tests/msg/X", text)


def test_constants_defaults_and_comments_are_no_fields() -> None:
    text = (
        'int32 LIMIT=3\nstring NAME = "a b"\nint32 x 5 # five\n\n# y\nstring<=4 s\nfloat32[<=2] v\nHeader header\n'
        + HEADER
    )
    stamp = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2), frame_id="f")
    plain_text = text.replace("Header header", "std_msgs/Header header")
    data = ros_payload("tests/msg/X", SimpleNamespace(x=9, s="abc", v=[1.0], header=stamp), plain_text)
    tree, _ = CdrParser("tests/msg/X", text).parse(data, 0, len(data))
    assert plain(data, tree) == {
        "x": 9,
        "s": "abc",
        "v": [1.0],
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "f"},
    }


F = FieldDescriptorProto
PROTO_TYPES: dict[int, Any] = {
    F.TYPE_DOUBLE: st.floats(allow_nan=False),
    F.TYPE_FLOAT: st.floats(width=32, allow_nan=False),
    F.TYPE_INT32: RANGES["int32"],
    F.TYPE_INT64: RANGES["int64"],
    F.TYPE_UINT32: RANGES["uint32"],
    F.TYPE_UINT64: RANGES["uint64"],
    F.TYPE_SINT32: RANGES["int32"],
    F.TYPE_SINT64: RANGES["int64"],
    F.TYPE_FIXED32: RANGES["uint32"],
    F.TYPE_FIXED64: RANGES["uint64"],
    F.TYPE_SFIXED32: RANGES["int32"],
    F.TYPE_SFIXED64: RANGES["int64"],
    F.TYPE_BOOL: st.booleans(),
    F.TYPE_STRING: TEXTS,
    F.TYPE_BYTES: st.binary(max_size=9),
}


@st.composite
def proto_messages(draw: st.DrawFn) -> tuple[Schema, Any, list[dict[str, Any]]]:
    """A schema, its class and a few messages of it as plain values."""
    outer, inner = DescriptorProto(name="Outer"), DescriptorProto(name="Inner")
    kinds: dict[str, tuple[int, bool, bool]] = {}
    for index in range(draw(st.integers(1, 6))):
        kind = draw(st.sampled_from(list(PROTO_TYPES)))
        repeated = draw(st.booleans())
        nested = draw(st.booleans())
        name = f"f{index}"
        target = inner if nested else outer
        field = target.field.add(name=name, number=draw(st.integers(1, 3000)) * 10 + index, type=kind)
        field.label = F.LABEL_REPEATED if repeated else F.LABEL_OPTIONAL
        kinds[name] = (kind, repeated, nested)
    outer.nested_type.append(inner)
    outer.field.add(name="inner", number=19, type=F.TYPE_MESSAGE, type_name=".t.Outer.Inner", label=F.LABEL_OPTIONAL)
    file = FileDescriptorProto(name="t.proto", package="t", syntax="proto3", message_type=[outer])
    pool = DescriptorPool()
    pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName("t.Outer"))
    messages = []
    for _ in range(draw(st.integers(1, 5))):
        fields: dict[str, Any] = {"inner": {}}
        for name, (kind, repeated, nested) in kinds.items():
            one = PROTO_TYPES[kind]
            value = draw(st.lists(one, max_size=4) if repeated else one)
            (fields["inner"] if nested else fields)[name] = value
        messages.append(fields)
    return Schema(1, FileDescriptorSet(file=[file]).SerializeToString(), "protobuf", "t.Outer"), made, messages


@given(proto_messages())
def test_protobuf_is_read_as_google_writes_it(made: tuple[Schema, Any, list[dict[str, Any]]]) -> None:
    schema, kind, messages = made
    parser = ProtobufParser(schema)
    for fields in messages:
        data = kind(**fields).SerializeToString()
        block = b"\xaa\xbb" + data + b"\xcc"
        tree, _ = parser.parse(block, 2, 2 + len(data))
        assert plain(block, tree) == fields


@given(proto_messages(), st.data())
def test_protobuf_that_is_cut_or_changed_does_not_crash(made: tuple, data: st.DataObject) -> None:
    schema, kind, messages = made
    payload = bytearray(kind(**messages[0]).SerializeToString() or b"\x08")
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    decode_all(ProtobufParser(schema), [bytes(payload[: data.draw(st.integers(0, len(payload)))])])


def test_protobuf_schema_that_is_no_schema_is_refused() -> None:
    for data in (b"", b"garbage", b"\xff\xff"):
        with pytest.raises(Undecodable, match=r"schema of t\.Outer cannot be read"):
            ProtobufParser(Schema(1, data, "protobuf", "t.Outer"))


def decode_all(
    parser: Parser, payloads: list[bytes], names: tuple[str, ...] | None = None
) -> tuple[np.ndarray, np.ndarray, dict[int, str], NumberDecoder]:
    """All payloads side by side through one NumberDecoder."""
    block = b"".join(b"\x77" + payload for payload in payloads)
    ends = np.cumsum([len(payload) + 1 for payload in payloads])
    starts = ends - [len(payload) for payload in payloads]
    if names is None:
        try:
            names = tuple(Components(parser.parse(block, int(starts[0]), int(ends[0]))[0]).names)
        except Undecodable:
            names = ("x",)
    decoder = NumberDecoder(parser, names)
    failures: dict[int, str] = {}
    rows, values = decoder.decode(block, starts, ends, failures)
    return rows, values, failures, decoder


@given(proto_messages())
def test_numbers_of_many_protobuf_messages_equal_those_of_each(made: tuple[Schema, Any, list[dict[str, Any]]]) -> None:
    schema, kind, messages = made
    parser = ProtobufParser(schema)
    payloads = [kind(**fields).SerializeToString() for fields in messages * 3]
    rows, values, failures, decoder = decode_all(parser, payloads)
    assert (rows.tolist(), failures) == (list(range(len(payloads))), {})
    for payload, row in zip(payloads, values, strict=True):
        parts = Components(parser.parse(payload, 0, len(payload))[0])
        alone = dict(zip(parts.names, (plain(payload, leaf) for leaf in parts.leaves), strict=True))
        for name, column in decoder._columns.items():
            assert row[column] == alone[name] if name in alone else np.isnan(row[column])


@given(ros_messages(), st.integers(1, 4))
def test_numbers_of_many_ros_messages_equal_those_of_each(made: tuple, repeat: int) -> None:
    lines, others, message = made
    text = SEPARATOR.join(["\n".join(lines), *others])
    data = ros_payload("tests/msg/Outer", spaced(message), text)
    parser = CdrParser("tests/msg/Outer", text)
    rows, values, failures, decoder = decode_all(parser, [data] * repeat)
    assert (len(rows), failures, decoder.missing, decoder.unknown) == (repeat, {}, None, None)
    parts = Components(parser.parse(data, 0, len(data))[0])
    expected = [plain(data, leaf) for leaf in parts.leaves]
    assert (values == np.array([expected] * repeat, float).reshape(repeat, -1)).all()


@pytest.mark.parametrize("encoding", ["protobuf", "ros2", "json"])
def test_joints_that_change_their_order_are_told_apart_by_name(encoding: str) -> None:
    made = [
        mcap_messages.joints(encoding, ["left", "rght"], [1.0, 2.0], 0),  # type: ignore[arg-type]
        mcap_messages.joints(encoding, ["rght", "left"], [3.0, 4.0], 10**9),  # type: ignore[arg-type]
        mcap_messages.joints(encoding, ["left"], [5.0], 2 * 10**9),  # type: ignore[arg-type]
        mcap_messages.joints(encoding, ["left", "rght", "more"], [6.0, 7.0, 8.0], 3 * 10**9),  # type: ignore[arg-type]
    ]
    parser = parser_for(encoding, made[0][0])
    _, values, failures, decoder = decode_all(parser, [data for _, data in made])
    assert not failures
    assert list(decoder._columns) == ["left.position", "rght.position"]
    np.testing.assert_array_equal(values, [[1, 2], [4, 3], [5, np.nan], [6, 7]])
    assert (decoder.missing, decoder.unknown) == ("rght.position", "more.position")


def parser_for(encoding: str, schema: mcap_messages.Schema) -> Parser:
    if encoding == "protobuf":
        return ProtobufParser(Schema(1, schema.data, "protobuf", schema.name))
    return CdrParser(schema.name, schema.data.decode()) if encoding == "ros2" else JsonParser()


def names_in(tree: Any) -> list[str]:
    return Components(tree).names


def test_names_of_components() -> None:
    pose = {"position": {"x": 1.0, "y": 2.0}, "orientation": {"w": 1.0}}
    assert names_in({"header": {"stamp": {"sec": 1.0}}, "pose": pose}) == [
        "pose.position.x",
        "pose.position.y",
        "pose.orientation.w",
    ]
    assert names_in({"data": [1.0, 2.0], "layout": {"dim": []}}) == ["data[0]", "data[1]"]
    assert names_in({"name": ["a", "b"], "position": [1.0, 2.0], "velocity": []}) == ["a.position", "b.position"]
    assert names_in({"names": ["a", "b"], "values": [1.0, 2.0]}) == ["a", "b"]
    assert names_in({"joints": [{"name": "a", "position": 1.0}, {"name": "b", "effort": 2.0}]}) == [
        "a.position",
        "b.effort",
    ]
    assert names_in({"transforms": [{"child_frame_id": "hand", "t": {"x": 1.0}}]}) == ["hand.t.x"]
    assert names_in({"on": True, "seq": 4, "sequenceNumber": 4, "pose_covariance": [1.0] * 36}) == ["on"]
    assert names_in({"when": {"sec": 1, "nanosec": 2}, "x": 1.0}) == ["x"]
    assert names_in({"name": ["a", "a"], "position": [1.0, 2.0]}) == ["a.position", "a.position#2"]


def test_long_arrays_are_components_only_when_they_are_the_message() -> None:
    assert len(names_in({"timestamp": {"sec": 1}, "data": [0.0] * 300})) == 300
    assert names_in({"ranges": [0.0] * 300, "angle": 1.0}) == ["angle"]
    assert names_in({"data": [0.0] * 2000}) == []


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_any_json_is_read_without_a_crash(value: Any) -> None:
    data = json.dumps(value).encode()
    rows, _, failures, _ = decode_all(JsonParser(), [data])
    assert (rows.tolist(), failures) == ([0], {})


@pytest.mark.parametrize("data", [b"", b"{", b'{"a": nope}', b"\xff\xfe", b"[" * 100_000])
def test_what_is_not_json_is_refused(data: bytes) -> None:
    with pytest.raises(Undecodable, match="it is not JSON"):
        JsonParser().parse(data, 0, len(data))


def test_a_number_too_large_for_json_is_infinite() -> None:
    _, values, _, _ = decode_all(JsonParser(), [b'{"x": 1' + b"0" * 5000 + b"}"])
    assert values[0, 0] == np.inf
