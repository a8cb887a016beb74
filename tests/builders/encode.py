"""Numbered pictures as recorders store them: one encoded picture a frame, in decoding order."""

from collections.abc import Sequence
from fractions import Fraction
from functools import cache

import av
import numpy as np

from tests.builders.pictures import numbered

VIDEO_CODECS = {
    "h264": ("libx264", {"preset": "ultrafast", "tune": "zerolatency", "crf": "20", "x264-params": "repeat-headers=1"}),
    "h265": ("libx265", {"preset": "ultrafast", "tune": "zerolatency", "x265-params": "log-level=none:bframes=0"}),
    "av1": ("libaom-av1", {"usage": "realtime", "cpu-used": "8", "lag-in-frames": "0"}),
    "vp9": ("libvpx-vp9", {"deadline": "realtime", "lag-in-frames": "0", "cpu-used": "8"}),
}


def encode_numbered(
    numbers: Sequence[int], image: str, width: int = 320, height: int = 240, *, gop: int = 250, shade: int = 90
) -> list[bytes]:
    """Pictures as `jpeg`, `png`, `raw` (rgb8 rows), `depth` (16UC1 rows), `h264`, `h265`, `av1` or `vp9`."""
    if image in VIDEO_CODECS:
        return _video([numbered(n, width, height, shade=shade) for n in numbers], image, gop)
    return [_still(n, image, width, height, shade) for n in numbers]


@cache
def _still(number: int, image: str, width: int, height: int, shade: int) -> bytes:
    picture = numbered(number, width, height, shade=shade)
    if image == "raw":
        return picture.tobytes()
    if image == "depth":
        return (picture[..., 0].astype("<u2") * 8).tobytes()
    codec = av.CodecContext.create({"jpeg": "mjpeg", "png": "png"}[image], "w")
    codec.width, codec.height, codec.time_base = width, height, Fraction(1, 30)  # type: ignore[attr-defined]
    codec.pix_fmt = {"jpeg": "yuvj420p", "png": "rgb24"}[image]  # type: ignore[attr-defined]
    frame = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format=codec.pix_fmt)  # type: ignore[attr-defined]
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])  # type: ignore[attr-defined]


def _video(pictures: Sequence[np.ndarray], image: str, gop: int) -> list[bytes]:
    name, options = VIDEO_CODECS[image]
    height, width = pictures[0].shape[:2]
    codec = av.CodecContext.create(name, "w")
    codec.width, codec.height = width, height  # type: ignore[attr-defined]
    codec.pix_fmt, codec.time_base = "yuv420p", Fraction(1, 30)  # type: ignore[attr-defined]
    codec.gop_size, codec.max_b_frames = gop, 0  # type: ignore[attr-defined]
    codec.options = options
    packets = []
    for index, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="yuv420p")
        frame.pts = index
        packets += codec.encode(frame)  # type: ignore[attr-defined]
    packets += codec.encode(None)  # type: ignore[attr-defined]
    if [packet.pts for packet in packets] != list(range(len(pictures))):
        raise RuntimeError(f"{name} did not give one packet a frame in display order: {[p.pts for p in packets]}")
    return [bytes(packet) for packet in packets]
