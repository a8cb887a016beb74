"""The part of a video file that belongs to one episode, as samples for a viewer that steps frame by frame.

A picture belongs to frame `i` when it stands within half a frame of `start_s + i / rate_hz` in the file. Nothing is
ever moved to fill a gap: a frame that has no picture has no sample, and a Problem says so.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
from av.bitstream import BitStreamFilterContext
from av.error import FFmpegError

from jiti.episodes.episode import ImageBatch, Problem
from jiti.episodes.keyframes import is_key_frame
from jiti.episodes.video_decode import MAX_PIXELS
from jiti.episodes.video_encode import H264Encoder, max_encoded_bytes
from jiti.errors import SourceError

BATCH_FRAMES = 32
"""Samples handed over at once. Our choice: a second of video, a few hundred kilobytes."""

SEEK_S = 2.0
"""Frames farther apart than this are decoded with a seek between them. Our choice: two usual key frame periods."""

CONTAINERS = ((4, b"ftyp", "mp4"), (0, b"\x1aE\xdf\xa3", "matroska"), (0, b"RIFF", "avi"))
"""Offset, magic bytes, FFmpeg's name. The format is never guessed: a playlist may not make FFmpeg open other files."""

_SHOWN_BY_BROWSERS = {"h264", "av1"}
"""What Rerun's viewer was seen to show in Chromium on every machine; H.265 needs hardware there."""


@dataclass(frozen=True, slots=True)
class Clip:
    """Where the pictures of one episode are."""

    path: Path
    label: str
    """The file as messages name it."""
    start_s: float
    """Time of frame 0 in the file."""
    rate_hz: float
    frame_count: int
    """Rows of the episode: how many pictures there must be."""


@dataclass(frozen=True, slots=True)
class ClipScan:
    """What is in a clip, known without decoding anything."""

    codec: str
    """As FFmpeg calls it: `h264`, `av1`, `mpeg4`."""
    pixel_format: str
    width: int
    height: int
    file_frames: int
    """Pictures in the whole file, by its header; 0 if it does not say."""
    encoding: Literal["h264", "av1"]
    """What `read_clip` yields."""
    copied: bool
    """Whether samples are handed on as they are; otherwise they are encoded anew."""
    frames: np.ndarray
    """(N,) int64, increasing: the frames of the episode that have a picture."""
    max_bytes: int
    """Upper bound of all samples that `read_clip` yields."""
    problems: tuple[Problem, ...]


def scan_clip(clip: Clip) -> ClipScan:
    """Look at the packets of a clip. Raises SourceError when the file is missing or is not a video."""
    frames, key, sizes, damaged = [], [], [], ""
    with _open(clip) as (container, stream):
        codec = stream.codec_context.codec.canonical_name
        width, height = stream.codec_context.width, stream.codec_context.height
        pixel_format = stream.codec_context.pix_fmt or ""
        shown = codec in _SHOWN_BY_BROWSERS and pixel_format in ("yuv420p", "yuvj420p")
        shown = shown and not stream.codec_context.has_b_frames
        file_frames = stream.frames
        rate = float(stream.average_rate) if stream.average_rate else None
        headers = len(stream.codec_context.extradata or b"") + 64
        try:
            for packet, frame in _packets(container, stream, clip):
                if packet.is_corrupt:
                    damaged = f"it is damaged at frame {frame}"
                    break
                if 0 <= frame < clip.frame_count:
                    frames.append(frame)
                    key.append(packet.is_keyframe)
                    sizes.append(packet.size + headers * packet.is_keyframe)
        except FFmpegError as error:
            damaged = f"it cannot be read after frame {frames[-1] if frames else 0}: {error.strerror}"
    if not 0 < width * height <= MAX_PIXELS:
        raise SourceError(f"{clip.label}: the video declares {width}x{height} pixels. Record or download it again.")
    present = np.unique(np.array(frames, np.int64))
    in_order = len(present) == len(frames) and np.array_equal(present, frames)
    copied = bool(shown and in_order and frames and key[0])
    return ClipScan(
        codec,
        pixel_format,
        width,
        height,
        file_frames,
        "av1" if copied and codec == "av1" else "h264",
        copied,
        present,
        sum(sizes) if copied else max_encoded_bytes(width, height, len(present), clip.rate_hz),
        tuple(_problems(clip, present, damaged, rate)),
    )


def read_clip(clip: Clip, scan: ClipScan, stream: str, frame_ns: np.ndarray) -> Iterator[ImageBatch]:
    """Yield the samples of `scan.frames` at their times in `frame_ns` (frame_count,): the first is a key frame,
    one a picture, no B-frames, H.264 as Annex B with SPS and PPS at key frames, AV1 as temporal units.
    """
    return in_batches(_copied(clip) if scan.copied else _encoded(clip, scan), stream, scan.encoding, frame_ns)


def in_batches(
    samples: Iterable[tuple[int, bytes]], stream: str, encoding: str, frame_ns: np.ndarray
) -> Iterator[ImageBatch]:
    """Group `(frame, data)` into batches, each sample at the time of its frame in `frame_ns`."""
    frames: list[int] = []
    data: list[bytes] = []
    for frame, sample in samples:
        frames.append(frame)
        data.append(sample)
        if len(data) == BATCH_FRAMES:
            yield ImageBatch(stream, frame_ns[frames], data, encoding)
            frames, data = [], []
    if data:
        yield ImageBatch(stream, frame_ns[frames], data, encoding)


def decode_clip(clip: Clip, frames: Sequence[int]) -> Iterator[tuple[int, av.VideoFrame]]:
    """Decode the frames (increasing) straight from the file, entering at key frames; left out are those without a
    picture and those that do not decode.
    """
    wanted = list(frames)
    while wanted:
        # One pass for frames that stand close together, a new seek for those that a key frame may be nearer to.
        near = {frame for frame in wanted if frame - wanted[0] <= SEEK_S * clip.rate_hz}
        wanted = wanted[len(near) :]
        for frame, picture in _decoded(clip, min(near), max(near)):
            if frame in near:
                yield frame, picture


def clip_pictures(clip: Clip) -> Iterator[tuple[int, av.VideoFrame]]:
    """Decode the whole clip: `(frame, picture)` in order, each frame once."""
    return _decoded(clip, 0, clip.frame_count - 1)


def _copied(clip: Clip) -> Iterator[tuple[int, bytes]]:
    """Packets as they are, in the framing that a stream without a container needs."""
    with _open(clip) as (container, stream):
        annex_b = BitStreamFilterContext("h264_mp4toannexb", stream) if stream.codec.canonical_name == "h264" else None
        extradata = stream.codec_context.extradata or b""
        sequence_header = extradata[4:] if extradata[:1] == b"\x81" else extradata
        for packet, frame in _packets(container, stream, clip):
            if packet.is_corrupt:
                return
            if not 0 <= frame < clip.frame_count:
                continue
            key = packet.is_keyframe
            if annex_b is not None:
                try:
                    sample = b"".join(bytes(part) for part in annex_b.filter(packet))
                except FFmpegError as error:
                    raise SourceError(
                        f"{clip.label}: the video is damaged at frame {frame} ({error.strerror}). "
                        "Record or download it again."
                    ) from error
            else:
                sample = bytes(packet)
                if key and not is_key_frame("av1", sample):
                    sample = sequence_header + sample
            yield frame, sample


def _encoded(clip: Clip, scan: ClipScan) -> Iterator[tuple[int, bytes]]:
    encoder = H264Encoder(scan.width, scan.height, clip.rate_hz)
    for frame, picture in clip_pictures(clip):
        yield frame, encoder.encode(picture)


def _decoded(clip: Clip, first: int, last: int) -> Iterator[tuple[int, av.VideoFrame]]:
    """Decode frames `first` to `last` in order, each once: of pictures that share a frame, the nearest in time."""
    best: tuple[float, int, av.VideoFrame] | None = None
    with _open(clip) as (container, stream):
        stream.thread_type = "AUTO"
        _seek(container, stream, clip, first)
        for picture in _pictures(container, stream):
            if picture.pts is None:
                continue
            position = (float(picture.pts * stream.time_base) - clip.start_s) * clip.rate_hz
            frame = _nearest(position)
            if frame > last:
                break
            if frame < first:
                continue
            if best is not None and frame == best[1]:
                if abs(position - frame) < best[0]:
                    best = abs(position - frame), frame, picture
                continue
            if best is not None:
                yield best[1:]
            best = abs(position - frame), frame, picture
    if best is not None:
        yield best[1:]


def _pictures(container: Any, stream: Any) -> Iterator[av.VideoFrame]:
    """Decode from where the container stands; what does not decode is left out."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except FFmpegError:
            return
        if packet is None:
            return
        try:
            yield from stream.decode(packet)
        except FFmpegError:
            continue


def _packets(container: Any, stream: Any, clip: Clip) -> Iterator[tuple[av.Packet, int]]:
    """Packets that may hold frames of the clip, in decoding order, with the frame that each holds."""
    _seek(container, stream, clip, 0)
    for packet in container.demux(stream):
        if packet.dts is None or packet.pts is None:
            continue
        frame = _frame_at(packet.pts, stream, clip)
        if _frame_at(packet.dts, stream, clip) >= clip.frame_count:
            return
        yield packet, frame


def _seek(container: Any, stream: Any, clip: Clip, frame: int) -> None:
    """Go to the last key frame at or before the frame; to the beginning when the file's index has none."""
    target_s = clip.start_s + (frame - 0.5) / clip.rate_hz
    if target_s <= 0:
        return
    try:
        container.seek(int(target_s / stream.time_base) + 1, stream=stream, backward=True)
    except FFmpegError:
        with suppress(FFmpegError):  # the file was just opened: it stands at its beginning
            container.seek(0)


def _frame_at(pts: int, stream: Any, clip: Clip) -> int:
    return _nearest((float(pts * stream.time_base) - clip.start_s) * clip.rate_hz)


def _nearest(position: float) -> int:
    return int(np.floor(position + 0.5))


@contextmanager
def _open(clip: Clip) -> Iterator[tuple[Any, Any]]:
    try:
        with clip.path.open("rb") as file:
            head = file.read(64)
    except OSError as error:
        raise SourceError(
            f"{clip.label}: the video is missing or cannot be opened ({error.strerror}). "
            "Download the dataset's videos again, or go on without this camera."
        ) from error
    if head.startswith(b"version https://git-lfs"):
        raise SourceError(f"{clip.label}: this is a Git LFS pointer, not the video. Run `git lfs pull` in the dataset.")
    container_format = next((name for at, magic, name in CONTAINERS if head[at:].startswith(magic)), None)
    if container_format is None:
        what = "is empty" if not head else "is not an MP4, Matroska or AVI video"
        raise SourceError(f"{clip.label}: the file {what}. Download or record it again.")
    reason = "it has no video stream"
    container = None
    try:
        container = av.open(str(clip.path.absolute()), format=container_format, metadata_errors="ignore")
    except FFmpegError as error:
        reason = str(error.strerror)
    if container is None or not container.streams.video:
        raise SourceError(
            f"{clip.label}: the video cannot be opened ({reason}); "
            "its recording or its download was cut off. Record or download it again."
        )
    with container:
        if container.streams.video[0].codec_context is None:
            raise SourceError(
                f"{clip.label}: the video is in a codec that FFmpeg cannot read, or its header is damaged. "
                "Record or download it again."
            )
        yield container, container.streams.video[0]


def _problems(clip: Clip, frames: np.ndarray, damaged: str, video_rate_hz: float | None) -> Iterator[Problem]:
    missing = clip.frame_count - len(frames)
    if not missing and not damaged:
        return
    rate = f", the video runs at {video_rate_hz:g} Hz" if video_rate_hz else ""
    what = f"{len(frames)} of {clip.frame_count} frames have a picture"
    if missing:
        gaps = np.setdiff1d(np.arange(clip.frame_count), frames)
        what += f"; the first without one is frame {gaps[0]}"
    if video_rate_hz and abs(video_rate_hz - clip.rate_hz) > 0.01 * clip.rate_hz:
        what += f"; the dataset says {clip.rate_hz:g} Hz{rate}"
    if damaged:
        what += f"; {damaged}"
    yield Problem(clip.label, what, "Frames without a picture stay empty; record or download the video again.", "error")
