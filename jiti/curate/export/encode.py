"""A camera of one episode as a video file: every picture decoded once and encoded at once."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from jiti.curate.export.codec import PIXELS, Codec
from jiti.curate.export.frames import Frames
from jiti.curate.export.numbers import LATE_S
from jiti.curate.export.stats import LevelStats, Stats, sampled, thinned
from jiti.episodes.episode import Episode
from jiti.episodes.video import decode_pictures
from jiti.episodes.video_decode import to_rgb
from jiti.episodes.video_encode import scaled
from jiti.errors import SourceError


def encode_camera(
    episode: Episode, camera: str, frames: Frames, size: tuple[int, int], fps: int, codec: Codec, path: Path, title: str
) -> Stats:
    """Write `path`, a picture a frame, (height, width) pixels; gives statistics of the pictures as they were recorded.

    A frame shows the latest picture at or before it; frames before the first picture, up to half a second, show the
    first. Raises SourceError that names the frame that has none, or whose picture cannot be decoded.
    """
    height, width = size
    levels = LevelStats()
    looked_at = set(sampled(frames.count).tolist())
    with _writing(path, fps, codec, width, height) as (container, stream):
        for frame, picture in pictures_of(episode, camera, frames, fps, title):
            if frame in looked_at:
                levels.add(thinned(to_rgb(picture)))
            prepared = scaled(picture, width, height)
            if frame == 0:
                # The encoder says nothing of colours by itself, and readers guess.
                stream.codec_context.color_range, stream.codec_context.colorspace = 1, prepared.colorspace
            prepared.pts, prepared.time_base = frame, Fraction(1, fps)
            prepared.pict_type = 0  # the recording's choice of key frames is not ours
            container.mux(stream.encode(prepared))
        container.mux(stream.encode())
    return levels.stats()


def picture_stats(episode: Episode, camera: str, count: int) -> Stats:
    """Of an episode's pictures, without encoding them: only those are decoded that are looked at."""
    levels = LevelStats()
    for _, picture in decode_pictures(episode, camera, sampled(count).tolist()):
        levels.add(thinned(to_rgb(picture)))
    return levels.stats()


def pictures_of(
    episode: Episode, camera: str, frames: Frames, fps: int, title: str
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Yield `(frame of the dataset, picture)` for every frame, in order."""
    wanted = np.unique(frames.recorded)
    stops = np.searchsorted(frames.recorded, wanted, side="right").tolist()
    begins = np.searchsorted(frames.recorded, wanted, side="left").tolist()
    where = {recorded: (begin, stop) for recorded, begin, stop in zip(wanted.tolist(), begins, stops, strict=True)}
    due = 0
    for recorded, picture in decode_pictures(episode, camera, wanted.tolist()):
        begin, stop = where[recorded]
        if begin > due and (due > 0 or begin > LATE_S * fps):
            raise _no_picture(title, camera, due, begin)
        for frame in range(due, stop):
            yield frame, picture
        due = stop
    if due < frames.count:
        raise _no_picture(title, camera, due, frames.count)


@contextmanager
def _writing(path: Path, fps: int, codec: Codec, width: int, height: int) -> Iterator[tuple[Any, Any]]:
    logging.getLogger("libav").setLevel(logging.ERROR)
    os.environ.setdefault("SVT_LOG", "1")  # SVT-AV1's own: errors alone, on a terminal that shows a bar
    with av.open(str(path), "w", format="mp4") as container:
        stream: Any = container.add_stream(codec.encoder, fps, options=codec.options)
        stream.width, stream.height, stream.pix_fmt = width, height, PIXELS
        stream.codec_context.time_base = Fraction(1, fps)
        yield container, stream


def _no_picture(title: str, camera: str, first: int, stop: int) -> SourceError:
    return SourceError(
        f"{title}, {camera}: frames {first} to {stop - 1} have no picture. Leave this camera out with --features, or "
        "the recording with --filter."
    )
