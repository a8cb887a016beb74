"""Videos copied without being decoded: an episode out of a LeRobot file, and pieces into one."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av

from jiti.episodes.video_clip import Clip

_FAST_START = {"movflags": "faststart"}
"""The index stands in front, so that a page or the Hub can play it while it loads, as lerobot writes it."""


def kind_of(path: Path) -> str:
    """What two videos must share to stand in one file: codec, size, pixels, clock and the decoder's settings."""
    container: Any = av.open(str(path))
    try:
        stream = container.streams.video[0]
        context = stream.codec_context
        settings = hashlib.sha256(context.extradata or b"").hexdigest()[:16]
        parts = (context.codec.canonical_name, context.width, context.height, context.pix_fmt, stream.time_base)
        return " ".join(map(str, (*parts, settings)))
    finally:
        container.close()


def describe(path: Path, fps: int) -> dict[str, Any]:
    """What lerobot's info.json says of a video that it did not encode itself."""
    container: Any = av.open(str(path))
    try:
        context = container.streams.video[0].codec_context
        return {
            "video.height": context.height,
            "video.width": context.width,
            "video.codec": context.codec.canonical_name,
            "video.pix_fmt": context.pix_fmt,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
            "is_depth_map": False,
        }
    finally:
        container.close()


def copy_clip(clip: Clip, path: Path) -> str | None:
    """Write the episode's part of a file to `path`, its first picture at 0; None, or why it cannot be copied.

    It can be where it begins on a key frame and its pictures need none of its neighbours'.
    """
    reason = _copy(clip, path)
    if reason is not None:
        path.unlink(missing_ok=True)
    return reason


def _copy(clip: Clip, path: Path) -> str | None:
    left = set(range(clip.frame_count))
    with av.open(str(clip.path)) as source, av.open(str(path), "w", format="mp4") as target:
        stream: Any = source.streams.video[0]
        tick = float(stream.time_base)
        period = 1 / clip.rate_hz
        copy: Any = target.add_stream_from_template(stream, opaque=True)
        source.seek(round(clip.start_s / tick), stream=stream, backward=True, any_frame=False)
        first: int | None = None
        for packet in source.demux(stream):
            if packet.pts is None:
                continue
            frame = round((packet.pts * tick - clip.start_s) / period)
            if first is None:
                if frame < 0:
                    continue
                if frame > 0 or not packet.is_keyframe:
                    return "it does not begin on a key frame"
                first = packet.pts
            elif frame not in left:
                return "its pictures and its neighbours' need each other"
            if abs(packet.pts * tick - clip.start_s - frame * period) > period / 2 or frame not in left:
                return "its pictures are not at the times of its frames"
            left.discard(frame)
            packet.dts = (packet.pts if packet.dts is None else packet.dts) - first
            packet.pts -= first
            packet.stream = copy
            target.mux(packet)
            if not left:
                return None
    return f"{len(left)} of its {clip.frame_count} pictures are missing"


def join_videos(pieces: Sequence[Path], path: Path, fps: int) -> None:
    """Write videos of one kind one behind the other; each begins where the frames of those before it end."""
    frames = 0
    with av.open(str(path), "w", format="mp4", options=_FAST_START) as target:
        copy: Any = None
        for piece in pieces:
            with av.open(str(piece)) as source:
                stream: Any = source.streams.video[0]
                if copy is None:
                    copy = target.add_stream_from_template(stream, opaque=True)
                begin = round(frames / fps / float(stream.time_base))
                for packet in source.demux(stream):
                    if packet.pts is None:
                        continue
                    packet.pts += begin
                    packet.dts = packet.pts if packet.dts is None else packet.dts + begin
                    packet.stream = copy
                    target.mux(packet)
                    frames += 1
