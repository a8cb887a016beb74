"""Small MCAP recordings of a pick: cameras with numbered pictures, joints with a gripper that closes and opens."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from tests.builders import mcap_messages
from tests.builders.encode import encode_numbered
from tests.builders.mcap_messages import MessageEncoding, Schema

START_NS = 1_750_000_000_000_000_000
GRIPPER_OPEN, GRIPPER_CLOSED = 0.04, 0.0
JOINT_NAMES = ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "gripper"]

Compression = Literal["zstd", "lz4", "none"]
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


@dataclass(frozen=True)
class Camera:
    """One camera. Picture `k` carries the number `first_number + k`."""

    image: str = "jpeg"
    """`jpeg`, `png`, `raw`, `depth`, `h264`, `h265`, `av1` or `vp9`."""
    rate_hz: float = 30.0
    start_s: float = 0.0
    """A camera that starts late has its first picture this long after the recording's start."""
    times_s: Sequence[float] | None = None
    """Exact times of the pictures from the recording's start, in place of rate and start."""
    width: int = 320
    height: int = 240
    gop: int = 250
    first_number: int = 0
    shade: int = 90
    encoding: MessageEncoding | None = None
    """Of this camera's messages; None for the recording's."""

    def times_ns(self, duration_s: float, start_ns: int) -> np.ndarray:
        times_s = self.times_s
        if times_s is None:
            times_s = np.arange(round((duration_s - self.start_s) * self.rate_hz)) / self.rate_hz + self.start_s
        return start_ns + np.rint(np.asarray(times_s, float) * 1e9).astype(np.int64)


@dataclass(frozen=True)
class Channel:
    """A topic of a hand-made recording."""

    schema: Schema | None
    message_encoding: str = ""
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Message:
    """One message, written in the order given."""

    topic: str
    time_ns: int
    data: bytes


@dataclass(frozen=True)
class Recording:
    """What `write_mcap` wrote, to compare with what a reader gives."""

    path: Path
    times_ns: dict[str, np.ndarray]
    """(N,) int64 a topic."""
    pictures: dict[str, list[bytes]]
    """Encoded pictures a camera."""
    numbers: dict[str, np.ndarray]
    """(N, size) float64 a numeric topic."""
    gripper_closes_ns: int
    gripper_opens_ns: int


def write_mcap(
    path: Path,
    *,
    cameras: Mapping[str, Camera] | None = None,
    duration_s: float = 2.0,
    encoding: MessageEncoding = "protobuf",
    joint_topic: str | None = "/joint_states",
    action_topic: str | None = "/action",
    numeric_hz: float = 50.0,
    start_ns: int = START_NS,
    instruction: str | None = None,
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    compression: Compression = "zstd",
    chunked: bool = True,
    indexed: bool = True,
    summary: bool = True,
    repeat: bool = True,
    statistics: bool = True,
    chunk_size: int = 256 * 1024,
) -> Recording:
    """Write a recording of a pick whose gripper closes at 30 % and opens at 70 % of its duration.

    Messages stand in order of time; at equal times cameras come first, in the order given.
    """
    cameras = {"/camera/front": Camera()} if cameras is None else cameras
    times: dict[str, np.ndarray] = {}
    pictures: dict[str, list[bytes]] = {}
    numbers: dict[str, np.ndarray] = {}
    channels: dict[str, Channel] = {}
    messages: list[Message] = []

    def add(topic: str, time_ns: int, made: tuple[Schema, bytes]) -> None:
        channels.setdefault(topic, Channel(made[0], made[0].message_encoding))
        messages.append(Message(topic, time_ns, made[1]))

    for topic, camera in cameras.items():
        times[topic] = camera.times_ns(duration_s, start_ns)
        count = range(camera.first_number, camera.first_number + len(times[topic]))
        pictures[topic] = encode_numbered(
            count, camera.image, camera.width, camera.height, gop=camera.gop, shade=camera.shade
        )
        for time_ns, data in zip(times[topic].tolist(), pictures[topic], strict=True):
            size = (camera.width, camera.height)
            add(topic, time_ns, mcap_messages.picture(camera.encoding or encoding, camera.image, *size, time_ns, data))
    numeric_ns = start_ns + np.rint(np.arange(int(duration_s * numeric_hz)) * 1e9 / numeric_hz).astype(np.int64)
    states = joint_positions((numeric_ns - start_ns) / 1e9, duration_s)
    for topic, values in ((joint_topic, states), (action_topic, np.roll(states, -1, 0))):
        if topic is None:
            continue
        times[topic], numbers[topic] = numeric_ns, values
        for time_ns, row in zip(numeric_ns.tolist(), values.tolist(), strict=True):
            if topic == joint_topic:
                add(topic, time_ns, mcap_messages.joints(encoding, JOINT_NAMES, row, time_ns))
            else:
                add(topic, time_ns, mcap_messages.vector(encoding, row, time_ns))
    write_messages(
        path,
        channels,
        sorted(messages, key=lambda message: message.time_ns),
        metadata={**({"episode": {"instruction": instruction}} if instruction else {}), **(metadata or {})},
        profile="ros2" if encoding == "ros2" else "",
        compression=compression,
        chunked=chunked,
        indexed=indexed,
        summary=summary,
        repeat=repeat,
        statistics=statistics,
        chunk_size=chunk_size,
    )
    held = np.flatnonzero(states[:, -1] == GRIPPER_CLOSED)
    closes, opens = (int(numeric_ns[held[0]]), int(numeric_ns[held[-1] + 1])) if len(held) else (start_ns, start_ns)
    return Recording(path, times, pictures, numbers, closes, opens)


def joint_positions(time_s: np.ndarray, duration_s: float) -> np.ndarray:
    """(N, 7) float64: six joints that swing and a gripper that is closed from 30 % to 70 % of the duration."""
    phase = time_s / duration_s
    swing = np.stack([np.sin(2 * np.pi * phase * (0.5 + 0.25 * k)) * (0.2 + 0.1 * k) for k in range(6)], 1)
    gripper = np.where((phase >= 0.3) & (phase < 0.7), GRIPPER_CLOSED, GRIPPER_OPEN)
    return np.concatenate([swing, gripper[:, None]], 1)


def write_messages(
    path: Path,
    channels: Mapping[str, Channel],
    messages: Iterable[Message],
    *,
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    profile: str = "",
    compression: Compression = "zstd",
    chunked: bool = True,
    indexed: bool = True,
    summary: bool = True,
    repeat: bool = True,
    statistics: bool = True,
    chunk_size: int = 256 * 1024,
) -> None:
    """Write messages exactly in the order given.

    `indexed`: chunk and message indexes. `summary`: anything between the data and the footer. `repeat`: channels
    and schemas again in the summary.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=chunk_size,
            compression=COMPRESSIONS[compression],
            index_types=IndexType.ALL if indexed and summary else IndexType.NONE,
            repeat_channels=repeat and summary,
            repeat_schemas=repeat and summary,
            use_chunking=chunked,
            use_statistics=statistics and summary,
            use_summary_offsets=summary,
        )
        writer.start(profile, "jiti tests")
        schemas: dict[Schema, int] = {}
        ids = {}
        for topic, channel in channels.items():
            if channel.schema and channel.schema not in schemas:
                s = channel.schema
                schemas[s] = writer.register_schema(s.name, s.schema_encoding, s.data)
            schema_id = schemas[channel.schema] if channel.schema else 0
            ids[topic] = writer.register_channel(topic, channel.message_encoding, schema_id, channel.metadata)
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, dict(values))
        for sequence, message in enumerate(messages):
            writer.add_message(ids[message.topic], message.time_ns, message.data, message.time_ns, sequence)
        writer.finish()
