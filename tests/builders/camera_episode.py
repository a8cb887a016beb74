"""An episode with one camera, held in memory."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jiti.episodes.clock import Clock
from jiti.episodes.episode import ImageBatch, PictureFormat, Problem, Stream

CAMERA = "/camera"


@dataclass
class CameraEpisode:
    """Pictures `data` at `time_ns`; frames are at `frame_ns`, by default the times of the pictures."""

    data: Sequence[bytes]
    encoding: str
    time_ns: np.ndarray
    frame_ns: np.ndarray | None = None
    raw: PictureFormat | None = None
    batch_size: int = 7
    episode_id: str = "memory"
    task: str | None = None
    fingerprint: str = "in memory"
    problems: Sequence[Problem] = ()
    image_bytes: int = 0
    yielded: int = 0
    """Pictures handed over so far."""

    streams: Mapping[str, Stream] = field(init=False)
    clock: Clock = field(init=False)

    def __post_init__(self) -> None:
        self.streams = {CAMERA: Stream(CAMERA, "camera", len(self.data), 30.0, (240, 320, 3), self.encoding)}
        self.clock = Clock(CAMERA, self.time_ns if self.frame_ns is None else self.frame_ns)

    def read(self, streams: Sequence[str] | None = None) -> Iterator[ImageBatch]:
        for start in range(0, len(self.data), self.batch_size):
            part = slice(start, start + self.batch_size)
            self.yielded += len(self.data[part])
            yield ImageBatch(CAMERA, self.time_ns[part], self.data[part], self.encoding, self.raw)


def at_30_hz(count: int) -> np.ndarray:
    """Times (count,) int64 of a camera at 30 Hz that began at 1 s."""
    return 1_000_000_000 + np.arange(count, dtype=np.int64) * 33_333_333
