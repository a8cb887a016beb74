"""Encode pictures as H.264 samples that a browser can step through: no B-frames, a key frame every second."""

from fractions import Fraction
from typing import Any, Literal

import av

Preset = Literal["ultrafast", "superfast"]

KEY_FRAME_PERIOD_S = 1.0
"""A seek decodes at most this much. Our choice: about what a person notices when scrubbing."""

QUALITY_CRF = 23
"""x264's constant rate factor. Its own default; LeRobot's is 30."""

MAX_BITS_A_PIXEL = 0.5
"""Ceiling of the bit rate, so that the size is known before encoding. Our choice: 4.6 Mbit/s at 640x480 and 30 Hz."""


_LIMITED = 1
"""AVCOL_RANGE_MPEG: luma from 16 to 235, what players take for granted."""

_BT601, _RGB = 5, 0
"""AVCOL_SPC_BT470BG, what JPEG uses, and AVCOL_SPC_RGB."""


class H264Encoder:
    """One picture in, one Annex B sample out, at once. Not thread-safe."""

    def __init__(self, width: int, height: int, rate_hz: float, *, preset: Preset = "superfast") -> None:
        """Pictures are scaled to `width` x `height` pixels, rounded down to even numbers as 4:2:0 needs.

        `ultrafast` takes half the time of `superfast` for a third more bytes.
        """
        self.width, self.height = max(2, width & ~1), max(2, height & ~1)
        rate = Fraction(rate_hz if rate_hz > 0 else 30.0).limit_denominator(1000)
        bits_a_second = int(MAX_BITS_A_PIXEL * self.width * self.height * rate) + 1
        context: Any = av.CodecContext.create("libx264", "w")
        context.width, context.height, context.pix_fmt = self.width, self.height, "yuv420p"
        context.framerate, context.time_base = rate, 1 / rate
        context.options = {
            "preset": preset,
            "tune": "zerolatency",
            "crf": str(QUALITY_CRF),
            "maxrate": str(bits_a_second),
            "bufsize": str(bits_a_second),
            "bf": "0",
            "g": str(max(1, round(KEY_FRAME_PERIOD_S * rate))),
            "sc_threshold": "0",
        }
        self._context = context
        self._count = 0

    def encode(self, picture: av.VideoFrame) -> bytes:
        """The sample of this picture; SPS and PPS stand in front of each key frame."""
        picture = scaled(picture, self.width, self.height)
        if not self._count:
            self._context.color_range = _LIMITED
            self._context.colorspace = picture.colorspace
        picture.pts, picture.time_base = self._count, self._context.time_base
        picture.pict_type = 0  # The decoder's choice of key frames is not ours.
        self._count += 1
        packets = self._context.encode(picture)
        if len(packets) != 1:
            raise RuntimeError(f"libx264 gave {len(packets)} samples for one picture; zerolatency gives one")
        return bytes(packets[0])


def scaled(picture: av.VideoFrame, width: int, height: int) -> av.VideoFrame:
    """The picture as 4:2:0 in limited range, `width` x `height` pixels, both rounded down to even numbers."""
    width, height = max(2, width & ~1), max(2, height & ~1)
    is_so = (picture.width, picture.height, picture.format.name) == (width, height, "yuv420p")
    if is_so and picture.color_range in (0, _LIMITED):
        return picture
    space = _BT601 if picture.colorspace == _RGB else picture.colorspace
    return picture.reformat(width, height, "yuv420p", dst_colorspace=space, dst_color_range=_LIMITED)


def max_encoded_bytes(width: int, height: int, count: int, rate_hz: float) -> int:
    """Upper bound of `count` samples of this size: the ceiling of the rate, the buffer twice, the headers."""
    return int(MAX_BITS_A_PIXEL * width * height * (count + 2 * rate_hz) / 8) + 4096
