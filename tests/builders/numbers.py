"""An episode of numbers alone, held in memory."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jiti.episodes.clock import Clock
from jiti.episodes.episode import NumericBatch, Problem, Stream

START_NS = 1_750_000_000_000_000_000


@dataclass
class Numbers:
    """One stream: values (N, size) at a rate, component names where there are any."""

    values: np.ndarray
    names: Sequence[str] = ()
    rate_hz: float = 30.0
    start_s: float = 0.0

    @property
    def time_ns(self) -> np.ndarray:
        seconds = self.start_s + np.arange(len(self.values)) / self.rate_hz
        return START_NS + np.rint(seconds * 1e9).astype(np.int64)


@dataclass
class NumbersEpisode:
    """Counts its passes, so that a test can ask for a single one."""

    numbers: Mapping[str, Numbers]
    frame_count: int
    rate_hz: float = 30.0
    episode_id: str = "numbers"
    task: str | None = None
    fingerprint: str = "in memory"
    problems: Sequence[Problem] = ()
    image_bytes: int = 0
    passes: list[tuple[str, ...]] = field(default_factory=list)

    streams: Mapping[str, Stream] = field(init=False)
    clock: Clock = field(init=False)

    def __post_init__(self) -> None:
        self.streams = {
            name: Stream(name, "numeric", len(n.values), n.rate_hz, n.values.shape[1:], "float64", names=tuple(n.names))
            for name, n in self.numbers.items()
        }
        frame_ns = START_NS + np.rint(np.arange(self.frame_count) * 1e9 / self.rate_hz).astype(np.int64)
        self.clock = Clock("camera", frame_ns)

    def read(self, streams: Sequence[str] | None = None) -> Iterator[NumericBatch]:
        names = tuple(self.numbers if streams is None else streams)
        self.passes.append(names)
        for name in names:
            one = self.numbers[name]
            for part in np.array_split(np.arange(len(one.values)), 3):
                yield NumericBatch(name, one.time_ns[part], np.asarray(one.values, np.float64)[part])
