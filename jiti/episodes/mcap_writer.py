"""Writes recordings as MCAP with Foxglove's Protobuf schemas: what recorders in simulation and on robots use."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from jiti import __version__
from jiti.durable import make_folder, replacing, save_failed
from jiti.episodes.episode import INTER_CODED
from jiti.episodes.mcap_contents import METADATA_NAME
from jiti.episodes.mcap_schemas import message_class
from jiti.errors import UsageError

CHUNK_BYTES = 1 << 20
"""Unpacked size of a chunk. The mcap library's default; readers hold one at a time."""

Numbers = Sequence[float] | np.ndarray


class _Discarded(Exception):
    """Ends a recording that is not to be kept."""


class McapWriter:
    """A recording in the making, in a temporary file beside `path` that takes its name when closed, and not before.

    With `with`, an exception discards it. Times are nanoseconds of one clock, 0 or later, and become both log time and
    timestamp. The same calls give the same messages byte for byte. Not thread-safe. Every method raises SaveFailed
    when the disk refuses.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        instruction: str | None = None,
        metadata: Mapping[str, str] | None = None,
        overwrite: bool = False,
    ) -> None:
        """Raises UsageError when `path` exists and is not to be overwritten."""
        path = Path(path)
        if path.exists() and not overwrite:
            raise UsageError(f"{path} exists already. Choose another name for the recording, or delete that one first.")
        make_folder(path.parent)
        self.path = path
        self._channels: dict[str, tuple[str, int]] = {}
        self._counts: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._closed = False
        self._stack = ExitStack()
        temporary = self._stack.enter_context(replacing(path))
        try:
            self._file: IO[bytes] = self._stack.enter_context(temporary.open("xb"))
        except OSError as error:
            self._end(_Discarded())
            raise save_failed(path, error) from error
        self._writer = Writer(self._file, CHUNK_BYTES, CompressionType.ZSTD)
        self._guarded(lambda: self._writer.start("", f"jiti {__version__}"))
        own = {**({"instruction": instruction} if instruction else {}), **(metadata or {})}
        if own:
            self.write_metadata(METADATA_NAME, own)

    def write_picture(self, topic: str, time_ns: int, data: bytes, *, frame_id: str = "") -> None:
        """A whole JPEG or PNG picture, as foxglove.CompressedImage. Raises UsageError for anything else."""
        if data.startswith(b"\xff\xd8\xff"):
            kind = "jpeg"
        elif data.startswith(b"\x89PNG"):
            kind = "png"
        else:
            raise UsageError(f"{topic}: a picture starts with {data[:4].hex(' ')}; give whole JPEG or PNG pictures.")
        self._write(topic, time_ns, "foxglove.CompressedImage", frame_id=frame_id, data=data, format=kind)

    def write_video(self, topic: str, time_ns: int, data: bytes, encoding: str, *, frame_id: str = "") -> None:
        """One frame of H.264 or H.265 (Annex B), AV1 (OBUs) or VP9, in decoding order and without B-frames.

        As foxglove.CompressedVideo. The first frame, and every key frame, carries its parameter sets.
        """
        if encoding not in INTER_CODED:
            raise UsageError(f"{topic}: video cannot be {encoding!r}; it can be: {', '.join(sorted(INTER_CODED))}.")
        self._write(topic, time_ns, "foxglove.CompressedVideo", frame_id=frame_id, data=data, format=encoding)

    def write_joints(
        self,
        topic: str,
        time_ns: int,
        names: Sequence[str],
        position: Numbers,
        *,
        velocity: Numbers | None = None,
        effort: Numbers | None = None,
    ) -> None:
        """Joints by name, in radians or metres, as foxglove.JointStates."""
        parts = {"position": position, "velocity": velocity, "effort": effort}
        given = {key: [float(v) for v in values] for key, values in parts.items() if values is not None}
        for key, values in given.items():
            _same_length(topic, names, key, values)
        joints = [{"name": n, **{key: values[k] for key, values in given.items()}} for k, n in enumerate(names)]
        self._write(topic, time_ns, "foxglove.JointStates", joints=joints)

    def write_pose(
        self, topic: str, time_ns: int, position_m: Numbers, orientation_xyzw: Numbers, *, frame_id: str
    ) -> None:
        """A pose in `frame_id`, as foxglove.PoseInFrame."""
        _same_length(topic, "xyz", "position_m", position_m)
        _same_length(topic, "xyzw", "orientation_xyzw", orientation_xyzw)
        pose = {
            "position": {axis: float(v) for axis, v in zip("xyz", position_m, strict=True)},
            "orientation": {axis: float(v) for axis, v in zip("xyzw", orientation_xyzw, strict=True)},
        }
        self._write(topic, time_ns, "foxglove.PoseInFrame", frame_id=frame_id, pose=pose)

    def write_vector(self, topic: str, time_ns: int, names: Sequence[str], values: Numbers) -> None:
        """Named numbers, such as an action, as jiti.NamedVector."""
        _same_length(topic, names, "values", values)
        self._write(topic, time_ns, "jiti.NamedVector", names=list(names), values=[float(v) for v in values])

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A metadata record, at any time before closing: how the episode ended, what recorded it."""
        self._guarded(lambda: self._writer.add_metadata(name, dict(values)))

    def close(self) -> None:
        """Finish the file and give it its name; it is then on the disk."""
        if self._closed:
            return
        try:
            self._guarded(self._writer.finish)
        except BaseException as error:
            self._end(error)
            raise
        self._closed = True
        self._stack.close()

    def discard(self) -> None:
        """Leave nothing behind."""
        if not self._closed:
            self._end(_Discarded())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        elif not self._closed:
            self._end(error)

    def _end(self, error: BaseException) -> None:
        self._closed = True
        self._stack.__exit__(type(error), error, error.__traceback__)

    def _write(self, topic: str, time_ns: int, schema: str, **fields: Any) -> None:
        if self._closed:
            raise UsageError(f"{self.path} is closed; nothing more can be written to it.")
        if not 0 <= time_ns < 1 << 63:
            raise UsageError(f"{topic}: the time {time_ns} ns is not in 0 to 2^63; give nanoseconds of one clock.")
        known, channel = self._channels.get(topic) or (schema, self._register(topic, schema))
        if known != schema:
            raise UsageError(f"{topic} holds {known}; a {schema} needs a topic of its own.")
        stamp = {"seconds": time_ns // 10**9, "nanos": time_ns % 10**9}
        data = message_class(schema)(timestamp=stamp, **fields).SerializeToString(deterministic=True)
        sequence = self._counts.get(topic, 0)
        self._guarded(lambda: self._writer.add_message(channel, time_ns, data, time_ns, sequence))
        self._counts[topic] = sequence + 1

    def _register(self, topic: str, schema: str) -> int:
        if schema not in self._schemas:
            data = build_file_descriptor_set(message_class(schema)).SerializeToString(deterministic=True)
            self._schemas[schema] = self._writer.register_schema(schema, "protobuf", data)
        channel = self._writer.register_channel(topic, "protobuf", self._schemas[schema])
        self._channels[topic] = (schema, channel)
        return channel

    def _guarded(self, write: Callable[[], object]) -> None:
        try:
            write()
        except OSError as error:
            raise save_failed(self.path, error) from error


def _same_length(topic: str, names: Sequence[str], what: str, values: Numbers) -> None:
    if len(values) != len(names):
        raise UsageError(f"{topic}: {what} has {len(values)} numbers for {len(names)} names: {', '.join(names)}.")
