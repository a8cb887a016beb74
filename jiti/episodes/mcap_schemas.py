"""Protobuf schemas that recordings are written with: Foxglove's, which Foxglove and Rerun show, and one of our own.

Foxglove's are copied field by field from foxglove-sdk (https://docs.foxglove.dev/docs/sdk/schemas); a test compares
them with the installed one. They are built here because the package with them takes 53 MB.
"""

from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP_FILE

_TIME = "google.protobuf.Timestamp"
_SCALARS = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "string": FieldDescriptorProto.TYPE_STRING,
    "bytes": FieldDescriptorProto.TYPE_BYTES,
}

DEFINITIONS: dict[str, tuple[tuple[str, int, str], ...]] = {
    "foxglove.CompressedImage": (
        ("timestamp", 1, _TIME),
        ("frame_id", 4, "string"),
        ("data", 2, "bytes"),
        ("format", 3, "string"),
    ),
    "foxglove.CompressedVideo": (
        ("timestamp", 1, _TIME),
        ("frame_id", 2, "string"),
        ("data", 3, "bytes"),
        ("format", 4, "string"),
    ),
    "foxglove.JointState": (
        ("name", 1, "string"),
        ("position", 2, "optional double"),
        ("velocity", 3, "optional double"),
        ("acceleration", 4, "optional double"),
        ("effort", 5, "optional double"),
    ),
    "foxglove.JointStates": (("timestamp", 1, _TIME), ("joints", 2, "repeated foxglove.JointState")),
    "foxglove.Vector3": (("x", 1, "double"), ("y", 2, "double"), ("z", 3, "double")),
    "foxglove.Quaternion": (("x", 1, "double"), ("y", 2, "double"), ("z", 3, "double"), ("w", 4, "double")),
    "foxglove.Pose": (("position", 1, "foxglove.Vector3"), ("orientation", 2, "foxglove.Quaternion")),
    "foxglove.PoseInFrame": (("timestamp", 1, _TIME), ("frame_id", 2, "string"), ("pose", 3, "foxglove.Pose")),
    "jiti.NamedVector": (("timestamp", 1, _TIME), ("names", 2, "repeated string"), ("values", 3, "repeated double")),
}
"""Message to its fields: name, number, type. `jiti.NamedVector` has one name a value."""


@cache
def message_class(name: str) -> type[Any]:
    """The Protobuf class of a message in `DEFINITIONS`, in a pool of its own: no other package's is disturbed."""
    return GetMessageClass(_pool().FindMessageTypeByName(name))


@cache
def _pool() -> DescriptorPool:
    pool = DescriptorPool()
    pool.AddSerializedFile(TIMESTAMP_FILE.serialized_pb)
    for name in DEFINITIONS:
        pool.Add(_file(name))
    return pool


def _path(name: str) -> str:
    return "google/protobuf/timestamp.proto" if name == _TIME else name.replace(".", "/") + ".proto"


def _file(name: str) -> FileDescriptorProto:
    """One file a message, as Foxglove has them."""
    package, short = name.split(".")
    message = DescriptorProto(name=short)
    needed = []
    for field_name, number, kind in DEFINITIONS[name]:
        label, _, kind = kind.rpartition(" ")
        field = message.field.add(name=field_name, number=number)
        field.label = (
            FieldDescriptorProto.LABEL_REPEATED if label == "repeated" else FieldDescriptorProto.LABEL_OPTIONAL
        )
        if kind in _SCALARS:
            field.type = _SCALARS[kind]
        else:
            field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{kind}"
            needed.append(_path(kind))
        if label == "optional":
            field.proto3_optional = True
            field.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{field_name}")
    return FileDescriptorProto(
        name=_path(name), package=package, syntax="proto3", dependency=needed, message_type=[message]
    )
