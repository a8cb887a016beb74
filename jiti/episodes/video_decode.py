"""Decode the samples of a camera stream, whatever their encoding, to PyAV frames."""

import contextlib
from typing import Any

import av
import numpy as np
from av.error import FFmpegError

from jiti.episodes.episode import INTER_CODED, PictureFormat

MAX_PIXELS = 100_000_000
"""A header that declares more is damage, not a picture. Our choice: twice the largest industrial sensors."""

DECODERS = {"jpeg": "mjpeg", "png": "png", "h264": "h264", "h265": "hevc", "av1": "libdav1d", "vp9": "vp9"}
"""`Encoding` to FFmpeg's decoder."""

RAW_FORMATS = {
    "rgb8": "rgb24",
    "bgr8": "bgr24",
    "rgba8": "rgba",
    "bgra8": "bgra",
    "mono8": "gray",
    "8UC1": "gray",
    "8UC3": "bgr24",
    "mono16": "gray16le",
    "bayer_rggb8": "bayer_rggb8",
    "bayer_bggr8": "bayer_bggr8",
    "bayer_gbrg8": "bayer_gbrg8",
    "bayer_grbg8": "bayer_grbg8",
    "yuv422": "uyvy422",
    "uyvy": "uyvy422",
    "yuv422_yuy2": "yuyv422",
    "yuyv": "yuyv422",
}
"""ROS 2 image encodings (sensor_msgs/image_encodings.hpp) to FFmpeg's pixel formats; depth is made grey below."""


class UndecodablePicture(Exception):
    """One picture cannot be decoded; the caller knows its stream and frame. Not for users."""


class SampleDecoder:
    """Samples in decoding order in, `(index, frame)` out; inter-coded streams may answer late. Not thread-safe."""

    def __init__(self, encoding: str, raw: PictureFormat | None = None, *, threads: int = 1) -> None:
        """With several threads an inter-coded stream answers later, and says of a picture later that it is bad."""
        self.encoding, self.raw, self._threads = encoding, raw, threads
        self._context: Any = None

    def decode(self, data: bytes, index: int) -> list[tuple[int, av.VideoFrame]]:
        """Raises UndecodablePicture; the decoder can go on with the next sample."""
        if not data:
            raise UndecodablePicture("it is empty")
        if self.encoding == "raw":
            if self.raw is None:
                raise UndecodablePicture("its pixel format is not given")
            return [(index, raw_frame(data, self.raw))]
        if self.encoding not in DECODERS:
            raise UndecodablePicture(f"its encoding {self.encoding!r} is not one of {', '.join(DECODERS)}, raw")
        if self._context is None:
            self._context = self._new_context()
        packet = av.Packet(data)
        packet.pts = packet.dts = index
        # Without the mark, FFmpeg's PNG decoder adds a picture to the one before it.
        packet.is_keyframe = self.encoding not in INTER_CODED
        try:
            frames = self._context.decode(packet)
        except (FFmpegError, ValueError) as error:
            if self.encoding not in INTER_CODED:
                self.reset()
            raise UndecodablePicture(_reason(error)) from error
        if self.encoding in INTER_CODED:
            return [(frame.pts, frame) for frame in frames if frame.pts is not None]
        if not frames:
            raise UndecodablePicture("the decoder found no picture in it")
        return [(index, frames[0])]

    def flush(self) -> list[tuple[int, av.VideoFrame]]:
        """What an inter-coded stream still holds back; the decoder starts anew after it."""
        if self._context is None or self.encoding not in INTER_CODED:
            return []
        frames = []
        with contextlib.suppress(EOFError, FFmpegError):
            frames = self._context.decode(None)
        self.reset()
        return [(frame.pts, frame) for frame in frames if frame.pts is not None]

    def reset(self) -> None:
        self._context = None

    def _new_context(self) -> Any:
        context: Any = av.CodecContext.create(DECODERS[self.encoding], "r")
        context.thread_count, context.thread_type = self._threads, "AUTO"
        # "explode": half a JPEG is an error, not a picture with a grey half.
        context.options = {"max_pixels": str(MAX_PIXELS)} | (
            {"err_detect": "explode"} if self.encoding == "jpeg" else {}
        )
        return context


def raw_frame(data: bytes, layout: PictureFormat) -> av.VideoFrame:
    """Rows of raw pixels as a frame; depth (`16UC1`, `32FC1`) becomes grey, near dark, scaled to its own range."""
    width, height, stride = layout.width, layout.height, layout.row_stride
    if not 0 < width * height <= MAX_PIXELS:
        raise UndecodablePicture(f"it declares {width}x{height} pixels")
    if len(data) < stride * (height - 1) + 1:
        raise UndecodablePicture(f"it has {len(data)} bytes; {height} rows of {stride} bytes are declared")
    if layout.pixel_format in ("16UC1", "32FC1"):
        depth = _rows(data, layout, np.dtype("<u2" if layout.pixel_format == "16UC1" else "<f4"))
        return av.VideoFrame.from_ndarray(depth_to_grey(depth), format="gray")
    name = RAW_FORMATS.get(layout.pixel_format)
    if name is None:
        known = ", ".join([*RAW_FORMATS, "16UC1", "32FC1"])
        raise UndecodablePicture(f"its pixel format {layout.pixel_format!r} is not one of {known}")
    frame = av.VideoFrame(width, height, name)
    plane = frame.planes[0]
    row_bytes = width * _bytes_a_pixel(name)
    if stride < row_bytes:
        raise UndecodablePicture(
            f"its rows have {stride} bytes; {width} pixels of {layout.pixel_format} need {row_bytes}"
        )
    rows = _padded(data, height, stride)[:, :row_bytes]
    target = np.zeros((height, plane.line_size), np.uint8)
    target[:, :row_bytes] = rows
    plane.update(np.resize(target.reshape(-1), plane.buffer_size).tobytes())
    return frame


def depth_to_grey(depth: np.ndarray) -> np.ndarray:
    """(height, width) of any number type to uint8: nearest 0, farthest 255, no reading (0 or not finite) 0."""
    depth = depth.astype(np.float32)
    valid = np.isfinite(depth) & (depth > 0)
    if not valid.any():
        return np.zeros(depth.shape, np.uint8)
    low, high = depth[valid].min(), depth[valid].max()
    grey = np.where(valid, (depth - low) / max(float(high - low), 1e-9) * 255, 0)
    return grey.astype(np.uint8)


def to_rgb(frame: av.VideoFrame) -> np.ndarray:
    """(height, width, 3) uint8; 16-bit grey is taken for depth."""
    if frame.format.name in ("gray16le", "gray16be"):
        grey = depth_to_grey(frame.to_ndarray())
        return np.repeat(grey[..., None], 3, 2)
    return frame.to_ndarray(format="rgb24")


def _rows(data: bytes, layout: PictureFormat, dtype: np.dtype) -> np.ndarray:
    row_bytes = layout.width * dtype.itemsize
    if layout.row_stride < row_bytes:
        raise UndecodablePicture(f"its rows have {layout.row_stride} bytes; {layout.width} pixels need {row_bytes}")
    rows = _padded(data, layout.height, layout.row_stride)[:, :row_bytes]
    return np.ascontiguousarray(rows).view(dtype)


def _padded(data: bytes, height: int, stride: int) -> np.ndarray:
    """(height, stride) uint8; the last row may lack its padding."""
    array = np.frombuffer(data, np.uint8)[: height * stride]
    return np.pad(array, (0, height * stride - len(array))).reshape(height, stride)


def _bytes_a_pixel(pixel_format: str) -> int:
    return av.VideoFormat(pixel_format).padded_bits_per_pixel // 8


def _reason(error: Exception) -> str:
    return "the decoder says: " + str(getattr(error, "strerror", None) or error).rstrip(".")
