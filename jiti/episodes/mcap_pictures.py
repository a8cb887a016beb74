"""Pictures of MCAP messages: their bytes as recorded, what they really are, and checks before anyone decodes them."""

import base64
import binascii
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from jiti.episodes.episode import PictureFormat
from jiti.episodes.mcap_layout import Blob, Number, Parser, Text, Tree, Undecodable

MAX_PIXELS = 100_000_000
"""A header that declares more is damage, not a picture. Our choice: twice the largest industrial sensors."""

PICTURE_TYPES = {"CompressedImage": "still", "CompressedVideo": "video", "RawImage": "raw", "Image": "raw"}
PICTURE_PACKAGES = ("foxglove", "foxglove_msgs", "sensor_msgs")

PIXEL_BYTES = {
    "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "mono16": 2, "16UC1": 2, "32FC1": 4,
    "yuv422": 2, "uyvy": 2, "yuv422_yuy2": 2, "yuyv": 2,
    "bayer_rggb8": 1, "bayer_bggr8": 1, "bayer_gbrg8": 1, "bayer_grbg8": 1,
}  # fmt: skip
"""Raw pixel formats that can be shown, with bytes a pixel: names of sensor_msgs/image_encodings.hpp."""
DEPTH_FORMATS = {"mono16", "16UC1", "32FC1"}

_VIDEO = {"h264": "h264", "avc": "h264", "h265": "h265", "hevc": "h265", "av1": "av1", "vp9": "vp9"}
_ANNEX_B = (b"\x00\x00\x00\x01", b"\x00\x00\x01")
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_COMPRESSED_DEPTH_HEADER = 12
"""ROS 2's compressed_depth_image_transport puts a ConfigHeader of 12 bytes before the PNG."""
_START_OF_FRAME = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
"""JPEG markers that are followed by the picture's size (ITU-T T.81, Table B.1)."""


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture as recorded."""

    data: bytes
    encoding: str
    """One of `Encoding` of `jiti.episodes.episode`."""
    raw: PictureFormat | None = None
    depth: bool = False
    declared: str | None = None
    """The format that the message declares, when the bytes say otherwise."""


def picture_kind(schema_name: str) -> str | None:
    """`still`, `video` or `raw` for a schema that holds pictures."""
    parts = schema_name.replace(".", "/").split("/")
    return PICTURE_TYPES.get(parts[-1]) if parts[0] in PICTURE_PACKAGES else None


class PictureDecoder:
    """Takes the picture out of the messages of one stream. The pictures stay encoded."""

    def __init__(self, parser: Parser, kind: str) -> None:
        self._parser = parser
        self._kind = kind
        self._sized: tuple[bytes, int] | None = None
        """The part of the last JPEG's header that tells its size, and where: one camera's are all alike."""

    def decode(self, block: bytes, start: int, end: int) -> Picture:
        """The picture of the message `block[start:end]`. Raises Undecodable."""
        tree, _ = self._parser.parse(block, start, end)
        data = _bytes(block, tree.get("data"))
        if not data:
            raise Undecodable("its picture is empty")
        if self._kind == "raw":
            return _raw(block, tree, data)
        declared = _text(tree.get("format"))
        if self._kind == "video":
            return _video(data, _VIDEO.get(declared.lower().strip()), declared)
        return self._still(data, declared)

    def _still(self, data: bytes, declared: str) -> Picture:
        words = declared.lower()
        video = next((encoding for name, encoding in _VIDEO.items() if words.startswith(name)), None)
        if video is not None:
            return _video(data, video, declared)
        if data[_COMPRESSED_DEPTH_HEADER:].startswith(_PNG):
            data = data[_COMPRESSED_DEPTH_HEADER:]
        if data.startswith(_JPEG):
            self._check_jpeg(data)
            encoding, depth, agrees = "jpeg", False, "png" not in words or "jpeg" in words
        elif data.startswith(_PNG):
            width, height, bit_depth, colour = _png_header(data)
            _check_pixels(width, height)
            # Grey with 16 bits is what every depth camera's PNG is.
            depth = (bit_depth == 16 and colour == 0) or any(words.startswith(f.lower()) for f in DEPTH_FORMATS)
            encoding, agrees = "png", "png" in words or "depth" in words or not any(w in words for w in ("jpeg", "jpg"))
        else:
            known = "a JPEG or PNG picture"
            raise Undecodable(f"it declares {declared!r} and starts with {data[:4].hex(' ')}, which is not {known}")
        return Picture(data, encoding, depth=depth, declared=None if agrees else declared)

    def _check_jpeg(self, data: bytes) -> None:
        if self._sized is not None:
            header, at = self._sized
            if data[at : at + len(header)] == header:
                return
        at = _start_of_frame(data)
        height, width = struct.unpack_from(">HH", data, at + 5)
        _check_pixels(width, height)
        self._sized = (data[at : at + 9], at)


def picture_shape(picture: Picture) -> tuple[int, ...]:
    """(height, width) or (height, width, channels) by the picture's header; () when it does not tell. Never decodes."""
    data = picture.data
    if picture.raw is not None:
        pixel = picture.raw.pixel_format
        channels = PIXEL_BYTES[pixel] if pixel in ("rgb8", "bgr8", "rgba8", "bgra8", "8UC3") else 1
        size = (picture.raw.height, picture.raw.width)
        return size if channels == 1 else (*size, channels)
    if picture.encoding == "jpeg":
        at = _start_of_frame(data)
        height, width, channels = struct.unpack_from(">HHB", data, at + 5)
        return (height, width) if channels == 1 else (height, width, channels)
    if picture.encoding == "png":
        width, height, _, colour = _png_header(data)
        channels = {2: 3, 3: 3, 4: 2, 6: 4}.get(colour, 1)
        return (height, width) if channels == 1 else (height, width, channels)
    return ()


def _video(data: bytes, encoding: str | None, declared: str) -> Picture:
    if encoding is None:
        raise Undecodable(f"its video format {declared!r} is not one of {', '.join(sorted(set(_VIDEO.values())))}")
    if encoding in ("h264", "h265") and not data.startswith(_ANNEX_B):
        raise Undecodable(f"it declares {encoding} and starts with {data[:4].hex(' ')}, not with an Annex B start code")
    return Picture(data, encoding)


def _raw(block: bytes, tree: Tree, data: bytes) -> Picture:
    pixel = _text(tree.get("encoding"))
    if pixel not in PIXEL_BYTES:
        raise Undecodable(f"its pixel format {pixel!r} is not one of {', '.join(PIXEL_BYTES)}")
    width, height = _whole(block, tree.get("width")), _whole(block, tree.get("height"))
    _check_pixels(width, height)
    row_bytes = width * PIXEL_BYTES[pixel]
    stride = _whole(block, tree.get("step")) or row_bytes
    if stride < row_bytes:
        raise Undecodable(f"its rows have {stride} bytes; {width} pixels of {pixel} need {row_bytes}")
    if len(data) < stride * (height - 1) + row_bytes:
        raise Undecodable(f"it has {len(data)} bytes; {height} rows of {stride} bytes are declared")
    if _whole(block, tree.get("is_bigendian", 0)) and pixel in DEPTH_FORMATS:
        size = PIXEL_BYTES[pixel]
        data = np.frombuffer(data[: len(data) // size * size], f">u{size}").astype(f"<u{size}").tobytes()
    return Picture(data, "raw", PictureFormat(width, height, pixel, stride), depth=pixel in DEPTH_FORMATS)


def _check_pixels(width: int, height: int) -> None:
    if not 0 < width * height <= MAX_PIXELS:
        raise Undecodable(f"it declares {width}x{height} pixels; the limit is {MAX_PIXELS // 1_000_000} megapixels")


def _png_header(data: bytes) -> tuple[int, int, int, int]:
    """Width, height, bit depth and colour type (PNG specification, 11.2.2)."""
    if len(data) < 29 or data[12:16] != b"IHDR":
        raise Undecodable("its PNG header is incomplete")
    return struct.unpack_from(">IIBB", data, 16)


def _start_of_frame(data: bytes) -> int:
    """Position of the marker before a JPEG's size. Raises Undecodable when there is none."""
    at, size = 2, len(data)
    while at + 9 < size and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _START_OF_FRAME:
            return at
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4])
    raise Undecodable("its JPEG header has no size")


def _bytes(block: bytes, value: Any) -> bytes:
    if isinstance(value, Blob):
        return block[value.offset : value.offset + value.length]
    if isinstance(value, str):
        try:
            return base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError) as error:
            raise Undecodable(f"its picture is not base64 ({error})") from error
    raise Undecodable("it has no field `data` with bytes")


def _text(value: Any) -> str:
    return value.text if isinstance(value, Text) else value if isinstance(value, str) else ""


def _whole(block: bytes, value: Any) -> int:
    """A whole number, read at its place. Raises Undecodable when there is none."""
    if isinstance(value, Number):
        if value.code == "constant":
            return int(value.constant)
        if value.size:
            return sum((block[value.offset + k] & 0x7F) << 7 * k for k in range(value.size))
        return int(np.frombuffer(block, value.code, 1, value.offset)[0])
    if isinstance(value, int | float) and value == value and abs(value) < 1e15:
        return int(value)
    raise Undecodable("it does not say how large its picture is")
