"""Pictures of a simulation as JPEG files."""

from fractions import Fraction
from typing import Any

import av
import numpy as np

JPEG_QUANTIZER = 3
"""Of FFmpeg's mjpeg encoder, 2 (best) to 31. Our choice: no visible blocks, 10 to 15 kB a picture of 256 x 256."""


def jpeg(picture: np.ndarray) -> bytes:
    """An RGB picture (height, width, 3) uint8 as a JPEG file; the same picture always gives the same bytes."""
    codec: Any = av.CodecContext.create("mjpeg", "w")
    codec.height, codec.width = picture.shape[:2]
    codec.pix_fmt, codec.time_base, codec.thread_count = "yuvj420p", Fraction(1, 1), 1
    codec.qmin = codec.qmax = JPEG_QUANTIZER
    frame = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="yuvj420p", dst_color_range="JPEG")
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])
