"""A lighter copy of a camera stream, for recordings that are larger than a viewer's memory."""

import os
from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from threading import local

import av
import numpy as np

from jiti.episodes.episode import INTER_CODED, Episode, ImageBatch, PictureFormat
from jiti.episodes.video_decode import SampleDecoder, UndecodablePicture
from jiti.episodes.video_encode import H264Encoder, scaled
from jiti.errors import SourceError

BATCH_FRAMES = 32
"""Samples handed over at once. Our choice: about a second."""

MAX_WORKERS = 4
"""Threads that decode JPEG, PNG and raw pictures. Our choice: the encoder keeps up with about this many."""


class Transcode(Iterator[ImageBatch]):
    """H.264 samples of a stream, in batches: `for batch in transcode(...)`. Closing it early ends its threads."""

    def __init__(self, episode: Episode, stream: str, max_height: int) -> None:
        known = episode.streams.get(stream)
        if known is None or known.kind not in ("camera", "depth"):
            cameras = ", ".join(s.name for s in episode.streams.values() if s.kind in ("camera", "depth")) or "none"
            raise SourceError(f"{episode.episode_id} has no camera {stream!r}; it has: {cameras}.")
        self.episode, self.stream, self.max_height = episode, stream, max_height
        self.rate_hz = known.rate_hz or episode.clock.rate_hz
        self.left_out = 0
        """Pictures so far that did not decode."""
        self.first_reason = ""
        """Why the first of them did not."""
        self._encoder: H264Encoder | None = None
        self._batches = self._run()

    def __next__(self) -> ImageBatch:
        return next(self._batches)

    def close(self) -> None:
        self._batches.close()

    def _run(self) -> Generator[ImageBatch]:
        times: list[int] = []
        data: list[bytes] = []
        for time_ns, picture in self._pictures():
            if self._encoder is None:
                height = min(self.max_height, picture.height)
                width = round(picture.width * height / picture.height)
                self._encoder = H264Encoder(width, height, self.rate_hz, preset="ultrafast")
            times.append(time_ns)
            data.append(self._encoder.encode(picture))
            if len(data) == BATCH_FRAMES:
                yield ImageBatch(self.stream, np.array(times, np.int64), data, "h264")
                times, data = [], []
        if data:
            yield ImageBatch(self.stream, np.array(times, np.int64), data, "h264")

    def _pictures(self) -> Iterator[tuple[int, av.VideoFrame]]:
        """Decoded pictures with their times, in order; pictures that stand alone are decoded by several threads."""
        workers = min(MAX_WORKERS, os.cpu_count() or 1)
        pending: deque[tuple[int, Future[av.VideoFrame | str]]] = deque()
        inter = _InterDecoder(self, workers)
        pool = _IntraPool(workers, self.max_height)
        try:
            for batch in self.episode.read([self.stream]):
                if not isinstance(batch, ImageBatch):
                    continue
                for time_ns, sample in zip(batch.time_ns.tolist(), batch.data, strict=True):
                    if batch.encoding in INTER_CODED:
                        yield from self._finished(pending, 0)
                        yield from inter.decode(batch.encoding, time_ns, sample)
                    else:
                        yield from inter.flush()
                        pending.append((time_ns, pool.submit(batch.encoding, batch.raw, sample)))
                        yield from self._finished(pending, 2 * workers)
            yield from self._finished(pending, 0)
            yield from inter.flush()
        finally:
            pool.close()

    def _finished(
        self, pending: "deque[tuple[int, Future[av.VideoFrame | str]]]", keep: int
    ) -> Iterator[tuple[int, av.VideoFrame]]:
        while len(pending) > keep:
            time_ns, future = pending.popleft()
            picture = future.result()
            if isinstance(picture, str):
                self.leave_out(picture)
            else:
                yield time_ns, picture

    def leave_out(self, reason: str, count: int = 1) -> None:
        self.left_out += count
        self.first_reason = self.first_reason or reason


def transcode(episode: Episode, stream: str, *, max_height: int) -> Transcode:
    """Encode a camera stream of any episode as H.264 without B-frames, at the times of its pictures.

    At most `max_height` pixels high, never larger than the source; one sample a picture, the first a key frame. A
    picture that does not decode is left out and counted in `left_out`. Memory is bounded by a few pictures and what
    `episode.read` holds. Raises SourceError for a stream that has no pictures.
    """
    return Transcode(episode, stream, max_height)


class _IntraPool:
    """Decodes and scales pictures that stand alone, each thread with its own decoder."""

    def __init__(self, workers: int, max_height: int) -> None:
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="transcode")
        self._max_height = max_height
        self._own = local()

    def submit(self, encoding: str, raw: PictureFormat | None, data: bytes) -> "Future[av.VideoFrame | str]":
        """The scaled picture, or why there is none."""
        return self._pool.submit(self._decode, encoding, raw, data)

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)

    def _decode(self, encoding: str, raw: PictureFormat | None, data: bytes) -> av.VideoFrame | str:
        decoder = getattr(self._own, "decoder", None)
        if decoder is None or (decoder.encoding, decoder.raw) != (encoding, raw):
            decoder = self._own.decoder = SampleDecoder(encoding, raw)
        try:
            picture = decoder.decode(data, 0)[0][1]
        except UndecodablePicture as error:
            return str(error)
        height = min(self._max_height, picture.height)
        return scaled(picture, round(picture.width * height / picture.height), height)


class _InterDecoder:
    """Decodes a video stream in order and gives each picture the time of its sample."""

    def __init__(self, owner: Transcode, threads: int) -> None:
        self._owner, self._threads = owner, threads
        self._decoder = SampleDecoder("")
        self._time_of: dict[int, int] = {}
        """Times of samples without a picture so far, by index."""
        self._count = 0
        self._reason = ""

    def decode(self, encoding: str, time_ns: int, data: bytes) -> Iterator[tuple[int, av.VideoFrame]]:
        if encoding != self._decoder.encoding:
            yield from self.flush()
            self._decoder = SampleDecoder(encoding, threads=self._threads)
        self._time_of[self._count] = time_ns
        self._count += 1
        try:
            pictures = self._decoder.decode(data, self._count - 1)
        except UndecodablePicture as error:
            self._reason = self._reason or str(error)
            return
        yield from self._timed(pictures)

    def flush(self) -> Iterator[tuple[int, av.VideoFrame]]:
        yield from self._timed(self._decoder.flush())
        if self._time_of:
            self._owner.leave_out(self._reason or "the decoder gave no picture for it", len(self._time_of))
            self._time_of.clear()

    def _timed(self, pictures: list[tuple[int, av.VideoFrame]]) -> Iterator[tuple[int, av.VideoFrame]]:
        for index, picture in pictures:
            if (time_ns := self._time_of.pop(index, None)) is not None:
                yield time_ns, picture
