"""What the messages of a channel are, and which parser reads them."""

import json
from dataclasses import dataclass
from typing import Any, Literal

from mcap.records import Channel, Schema

from jiti.episodes.mcap_cdr import CdrParser
from jiti.episodes.mcap_layout import Fixed, Parser, Tree, Undecodable
from jiti.episodes.mcap_pictures import picture_kind
from jiti.episodes.mcap_protobuf import ProtobufParser

SUPPORTED = "Protobuf (`protobuf`), ROS 2 CDR (`cdr` with `ros2msg` schemas) and JSON (`json`)"

NOT_NUMBERS = {
    "CameraCalibration", "CameraInfo", "Log", "ParameterEvent", "PointCloud", "PointCloud2", "OccupancyGrid", "Grid",
    "VoxelGrid", "SceneUpdate", "ImageAnnotations", "MarkerArray", "Marker", "DiagnosticArray", "CompressedPointCloud",
    "RawAudio", "CompressedAudio", "PacketStats",
}  # fmt: skip
"""Messages with numbers in them that are not a state or an action of the robot. Our choice."""

Role = Literal["picture", "numbers", "other"]


class JsonParser:
    """Reads a JSON message; its tree holds values, not places."""

    vectorized = False

    def parse(self, block: bytes, start: int, end: int) -> tuple[Tree, list[Fixed]]:
        try:
            # Whole numbers become floats: they end up as such, and one with 5,000 digits is no reason to stop.
            value: Any = json.loads(block[start:end], parse_int=float)
        except (ValueError, RecursionError) as error:
            raise Undecodable(f"it is not JSON ({error})") from error
        return (value if isinstance(value, dict) else {"value": value}), []


@dataclass(frozen=True, slots=True)
class Reading:
    """How a channel is read."""

    role: Role
    parser: Parser | None
    """None when its encoding is not supported."""
    picture: str | None = None
    """`still`, `video` or `raw`."""
    unsupported: str | None = None
    """Why there is no parser."""


def reading_of(channel: Channel, schema: Schema | None) -> Reading:
    """How to read the messages of a channel."""
    name = schema.name if schema else ""
    try:
        parser = _parser(channel, schema)
    except Undecodable as error:
        return Reading("other", None, unsupported=str(error))
    if picture := picture_kind(name):
        return Reading("picture", parser, picture)
    if name.replace(".", "/").split("/")[-1] in NOT_NUMBERS:
        return Reading("other", parser)
    return Reading("numbers", parser)


def _parser(channel: Channel, schema: Schema | None) -> Parser:
    encoding = channel.message_encoding
    if channel.schema_id and schema is None:
        raise Undecodable(f"its schema {channel.schema_id} is not in the file")
    schema_encoding = schema.encoding if schema else ""
    if encoding == "json" and schema_encoding in ("jsonschema", ""):
        return JsonParser()
    if encoding == "protobuf" and schema is not None and schema_encoding == "protobuf":
        return ProtobufParser(schema)
    if encoding == "cdr" and schema is not None and schema_encoding == "ros2msg":
        return CdrParser(schema.name, schema.data.decode("utf-8", "replace"))
    raise Undecodable(
        f"its messages are {encoding or 'of no declared encoding'!r} with {schema_encoding or 'no'!r} schemas"
    )
