"""Pictures of any episode by frame number, decoded."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol, runtime_checkable

import av
import numpy as np

from jiti.episodes.episode import INTER_CODED, Episode, ImageBatch
from jiti.episodes.keyframes import is_key_frame
from jiti.episodes.video_decode import SampleDecoder, UndecodablePicture, to_rgb
from jiti.errors import SourceError

MAX_HELD_BYTES = 16 << 20
"""Samples since the last key frame that are kept undecoded until a frame among them is wanted. Our choice."""


@runtime_checkable
class DecodesItself(Protocol):
    """An episode that has a shorter way to a picture than through `read`."""

    def decode(self, stream: str, frames: Sequence[int]) -> Iterator[tuple[int, av.VideoFrame]] | None:
        """Yield the frames (increasing, each once) that have a picture; None where `read` is as short."""
        ...


def decode_frames(episode: Episode, stream: str, frames: Iterable[int]) -> Iterator[tuple[int, np.ndarray]]:
    """As `decode_pictures`, with pictures as (height, width, 3) uint8 RGB."""
    for frame, picture in decode_pictures(episode, stream, frames):
        yield frame, to_rgb(picture)


def decode_pictures(episode: Episode, stream: str, frames: Iterable[int]) -> Iterator[tuple[int, av.VideoFrame]]:
    """Yield `(frame, picture)` in the order of the frames, each once.

    A frame shows the latest picture at or before its time; frames before the stream's first picture, and those that a
    recording lacks, are left out. Raises SourceError for a stream that has no pictures, a frame that is not in the
    episode, and a picture that does not decode.
    """
    known = episode.streams.get(stream)
    if known is None or known.kind not in ("camera", "depth"):
        cameras = ", ".join(s.name for s in episode.streams.values() if s.kind in ("camera", "depth")) or "none"
        raise SourceError(f"{episode.episode_id} has no camera {stream!r}; it has: {cameras}.")
    wanted = sorted(set(frames))
    count = episode.clock.frame_count
    if wanted and not 0 <= wanted[0] <= wanted[-1] < count:
        bad = wanted[0] if wanted[0] < 0 else wanted[-1]
        raise SourceError(f"{episode.episode_id} has no frame {bad}; it has 0 to {count - 1}.")
    own = episode.decode(stream, wanted) if isinstance(episode, DecodesItself) else None
    yield from own if own is not None else _through_read(episode, stream, wanted)


def _through_read(episode: Episode, stream: str, wanted: list[int]) -> Iterator[tuple[int, av.VideoFrame]]:
    """One pass over the stream that decodes only what leads to the wanted frames."""
    decoder = SampleDecoder("")
    held: list[tuple[int, bytes]] = []  # Samples since the last key frame that were not fed to the decoder.
    held_bytes = 0
    waiting: dict[int, list[int]] = {}  # Wanted frames by the sample that shows them, until it is decoded.

    def feed(samples: Iterable[tuple[int, bytes]]) -> Iterator[tuple[int, av.VideoFrame]]:
        for index, data in samples:
            try:
                pictures = decoder.decode(data, index)
            except UndecodablePicture as error:
                if index in waiting:
                    raise _undecodable(episode, stream, waiting[index][0], str(error)) from error
                continue  # A later sample that needs this one fails too.
            yield from shown(pictures)

    def shown(pictures: Iterable[tuple[int, av.VideoFrame]]) -> Iterator[tuple[int, av.VideoFrame]]:
        for index, picture in pictures:
            yield from ((frame, picture) for frame in waiting.pop(index, ()))

    for index, data, batch, frames in _samples_with_frames(episode, stream, wanted):
        if (batch.encoding, batch.raw) != (decoder.encoding, decoder.raw):
            yield from shown(decoder.flush())
            decoder, held, held_bytes = SampleDecoder(batch.encoding, batch.raw), [], 0
        if is_key_frame(batch.encoding, data) and held:
            held, held_bytes = [], 0
            decoder.reset()
        held.append((index, data))
        held_bytes += len(data)
        if frames:
            waiting[index] = frames
        if waiting or (batch.encoding in INTER_CODED and held_bytes > MAX_HELD_BYTES):
            samples, held, held_bytes = held, [], 0
            yield from feed(samples)
    yield from shown(decoder.flush())
    for frames in waiting.values():
        raise _undecodable(episode, stream, frames[0], "the decoder gave no picture for it")


def _samples_with_frames(
    episode: Episode, stream: str, wanted: Sequence[int]
) -> Iterator[tuple[int, bytes, ImageBatch, list[int]]]:
    """Samples in order, `(index, data, batch, wanted frames that show it)`, up to the last that is needed.

    Of several frames with one time, as of several samples with one time, the first belongs to the first.
    """
    frame_ns = episode.clock.frame_ns
    first_equal = np.searchsorted(frame_ns, frame_ns[list(wanted)], side="left")
    targets = [(frame, int(frame_ns[frame]), frame - int(k)) for frame, k in zip(wanted, first_equal, strict=True)]

    before: tuple[int, bytes, ImageBatch] | None = None
    last_ns, rank = None, 0
    for index, (time_ns, data, batch) in enumerate(_samples(episode, stream)):
        rank = rank + 1 if time_ns == last_ns else 0
        last_ns = time_ns
        frames = []
        while targets and (time_ns > targets[0][1] or (time_ns == targets[0][1] and rank > targets[0][2])):
            frames.append(targets.pop(0)[0])
        if before is not None:
            yield *before, frames
        if not targets:
            return
        before = index, data, batch
    if before is not None:
        yield *before, [frame for frame, _, _ in targets]


def _samples(episode: Episode, stream: str) -> Iterator[tuple[int, bytes, ImageBatch]]:
    for batch in episode.read([stream]):
        if isinstance(batch, ImageBatch):
            for time_ns, data in zip(batch.time_ns.tolist(), batch.data, strict=True):
                yield time_ns, data, batch


def _undecodable(episode: Episode, stream: str, frame: int, reason: str) -> SourceError:
    return SourceError(
        f"{episode.episode_id}, {stream}, frame {frame}: the picture cannot be decoded: {reason}. "
        "Go on without this camera, or record the episode again."
    )
