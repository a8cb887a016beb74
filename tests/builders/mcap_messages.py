"""Messages of tests in the three encodings, made by other people's encoders so that they check our decoders."""

import base64
import json
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any, Literal

import foxglove.messages as fox
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap_ros2._dynamic import serialize_dynamic

MessageEncoding = Literal["protobuf", "ros2", "json"]

SEPARATOR = "\n" + "=" * 80 + "\n"
TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
HEADER = SEPARATOR + "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + SEPARATOR + TIME
ROS_TYPES = {
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data\n" + HEADER,
    "sensor_msgs/msg/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
        "uint8[] data\n" + HEADER
    ),
    "foxglove_msgs/msg/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n" + SEPARATOR + TIME
    ),
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + HEADER
    ),
    "std_msgs/msg/Float64MultiArray": (
        "std_msgs/MultiArrayLayout layout\nfloat64[] data\n"
        + SEPARATOR
        + "MSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n"
        + SEPARATOR
        + "MSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n"
    ),
    "std_msgs/msg/String": "string data\n",
}


@dataclass(frozen=True)
class Schema:
    """What a channel is registered with."""

    name: str
    schema_encoding: str
    data: bytes
    message_encoding: str


def ros_schema(name: str, text: str | None = None) -> Schema:
    return Schema(name, "ros2msg", (text if text is not None else ROS_TYPES[name]).encode(), "cdr")


def ros_payload(name: str, message: Any, text: str | None = None) -> bytes:
    return serialize_dynamic(name, text if text is not None else ROS_TYPES[name])[name](message)


def json_schema(name: str) -> Schema:
    return Schema(name, "jsonschema", b'{"type":"object"}', "json")


def fox_schema(kind: type) -> Schema:
    schema = kind.get_schema()  # type: ignore[attr-defined]
    return Schema(schema.name, schema.encoding, schema.data, "protobuf")


@cache
def vector_class() -> tuple[Schema, type]:
    """A protobuf message that no library ships: `Vector { repeated double values = 1; }`."""
    file = FileDescriptorProto(name="tests/Vector.proto", package="tests", syntax="proto3")
    repeated, double = FieldDescriptorProto.LABEL_REPEATED, FieldDescriptorProto.TYPE_DOUBLE
    field = FieldDescriptorProto(name="values", number=1, type=double, label=repeated)
    file.message_type.append(DescriptorProto(name="Vector", field=[field]))
    pool = DescriptorPool()
    pool.Add(file)
    data = FileDescriptorSet(file=[file]).SerializeToString()
    return Schema("tests.Vector", "protobuf", data, "protobuf"), GetMessageClass(
        pool.FindMessageTypeByName("tests.Vector")
    )


def stamp(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def ros_header(time_ns: int) -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=time_ns // 10**9, nanosec=time_ns % 10**9), frame_id="base")


def picture(
    encoding: MessageEncoding, image: str, width: int, height: int, time_ns: int, data: bytes
) -> tuple[Schema, bytes]:
    """A picture as its usual message: CompressedImage, RawImage or Image, CompressedVideo."""
    at = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
    if image in ("raw", "depth"):
        pixels, step = ("rgb8", width * 3) if image == "raw" else ("16UC1", width * 2)
        if encoding == "protobuf":
            message = fox.RawImage(
                timestamp=fox.Timestamp(**at), width=width, height=height, encoding=pixels, step=step, data=data
            )
            return fox_schema(fox.RawImage), message.encode()
        fields = {"width": width, "height": height, "encoding": pixels, "step": step}
        if encoding == "ros2":
            ros = SimpleNamespace(header=ros_header(time_ns), is_bigendian=0, data=data, **fields)
            return ros_schema("sensor_msgs/msg/Image"), ros_payload("sensor_msgs/msg/Image", ros)
        body = {"timestamp": at, "frame_id": "", **fields, "data": base64.b64encode(data).decode()}
        return json_schema("foxglove.RawImage"), json.dumps(body).encode()
    video = image not in ("jpeg", "png")
    if encoding == "protobuf":
        kind = fox.CompressedVideo if video else fox.CompressedImage
        return fox_schema(kind), kind(timestamp=fox.Timestamp(**at), data=data, format=image).encode()
    if encoding == "ros2":
        name = "foxglove_msgs/msg/CompressedVideo" if video else "sensor_msgs/msg/CompressedImage"
        header = ros_header(time_ns)
        ros = SimpleNamespace(header=header, timestamp=header.stamp, frame_id="base", format=image, data=data)
        return ros_schema(name), ros_payload(name, ros)
    name = "foxglove.CompressedVideo" if video else "foxglove.CompressedImage"
    body = {"timestamp": at, "frame_id": "", "data": base64.b64encode(data).decode(), "format": image}
    return json_schema(name), json.dumps(body).encode()


def joints(encoding: MessageEncoding, names: list[str], positions: list[float], time_ns: int) -> tuple[Schema, bytes]:
    """Joint positions by name."""
    if encoding == "protobuf":
        states = [fox.JointState(name=n, position=p) for n, p in zip(names, positions, strict=True)]
        message = fox.JointStates(timestamp=fox.Timestamp(**stamp(time_ns)), joints=states)
        return fox_schema(fox.JointStates), message.encode()
    if encoding == "ros2":
        ros = SimpleNamespace(header=ros_header(time_ns), name=names, position=positions, velocity=[], effort=[])
        return ros_schema("sensor_msgs/msg/JointState"), ros_payload("sensor_msgs/msg/JointState", ros)
    body = {"header": {"stamp": stamp(time_ns), "frame_id": ""}, "name": names, "position": positions}
    return json_schema("sensor_msgs/msg/JointState"), json.dumps(body).encode()


def vector(encoding: MessageEncoding, values: list[float], time_ns: int) -> tuple[Schema, bytes]:
    """Numbers without names."""
    if encoding == "protobuf":
        schema, kind = vector_class()
        return schema, kind(values=values).SerializeToString()
    if encoding == "ros2":
        layout = SimpleNamespace(dim=[], data_offset=0)
        ros = SimpleNamespace(layout=layout, data=values)
        return ros_schema("std_msgs/msg/Float64MultiArray"), ros_payload("std_msgs/msg/Float64MultiArray", ros)
    return json_schema("tests.Vector"), json.dumps({"timestamp": stamp(time_ns), "data": values}).encode()
