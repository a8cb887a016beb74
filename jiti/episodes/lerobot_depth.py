"""Depth of LeRobot 0.6: 12-bit codes in video, or TIFF in Parquet, as 16-bit PNG pictures in millimetres.

The code's scale is lerobot/datasets/depth_utils.py's: quantum q of 0 to 4095 lies between log(min + shift) and
log(max + shift), or between min and max without `use_log`; all in metres.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import numpy as np
from av.error import FFmpegError

from jiti.episodes.video_clip import Clip, clip_pictures

CODE_FORMATS = ("gray12le", "yuv420p12le", "yuv444p12le")
"""Pixel formats of video that hold 12-bit codes; others show depth as colours or grey and are shown as they are."""

_LAST_CODE = 4095


@dataclass(frozen=True)
class DepthCode:
    """How metres became codes; the defaults are lerobot's (lerobot/configs/video.py)."""

    min_m: float = 0.01
    max_m: float = 10.0
    shift_m: float = 3.5
    use_log: bool = True

    @classmethod
    def from_info(cls, info: Mapping[str, Any]) -> "DepthCode":
        """From a feature's `info`; what it lacks has the default."""

        def number(key: str, default: float) -> float:
            value = info.get(f"video.{key}", info.get(key))
            return float(value) if isinstance(value, int | float) else default

        return cls(
            number("depth_min", cls.min_m),
            number("depth_max", cls.max_m),
            number("shift", cls.shift_m),
            bool(number("use_log", True)),
        )

    def millimetres(self) -> np.ndarray:
        """Depth of each code: (4096,) uint16."""
        share = np.arange(_LAST_CODE + 1) / _LAST_CODE
        if self.use_log:
            low, high = np.log([self.min_m + self.shift_m, self.max_m + self.shift_m])
            metres = np.exp(low + share * (high - low)) - self.shift_m
        else:
            metres = self.min_m + share * (self.max_m - self.min_m)
        return np.clip(np.rint(metres * 1000), 0, 65535).astype(np.uint16)


def read_depth_clip(clip: Clip, code: DepthCode) -> Iterator[tuple[int, bytes]]:
    """Yield `(frame, PNG)` of a video of codes."""
    table = code.millimetres()
    for frame, picture in clip_pictures(clip):
        codes = picture.reformat(format="gray12le").to_ndarray()
        yield frame, png16(table[np.minimum(codes, _LAST_CODE)])


def tiff_to_png16(data: bytes) -> bytes | None:
    """16-bit TIFF as PNG; None when it cannot be decoded."""
    try:
        frames = av.CodecContext.create("tiff", "r").decode(av.Packet(data))  # type: ignore[attr-defined]
    except (FFmpegError, ValueError):
        return None
    if not frames or frames[0].format.name not in ("gray16le", "gray16be"):
        return None
    return png16(frames[0].to_ndarray())


def png16(depth: np.ndarray) -> bytes:
    """(height, width) uint16 as a grey PNG file."""
    encoder: Any = av.CodecContext.create("png", "w")
    encoder.height, encoder.width = depth.shape
    encoder.pix_fmt, encoder.time_base = "gray16be", Fraction(1, 30)
    encoder.options = {"compression_level": "1"}
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(depth, "<u2"), format="gray16le")
    return b"".join(bytes(packet) for packet in encoder.encode(frame.reformat(format="gray16be")))
