"""The records that every reader gives: streams, samples in batches, problems, an episode.

All times are integer nanoseconds in the recording's own clock. Sample times never go back within a
stream: a reader unwraps clock jumps and says so in `Episode.problems`.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from jiti.episodes.clock import Clock

StreamKind = Literal["camera", "depth", "numeric", "other"]
Encoding = Literal["jpeg", "png", "raw", "h264", "h265", "av1", "vp9"]
INTER_CODED: frozenset[str] = frozenset({"h264", "h265", "av1", "vp9"})


@dataclass(frozen=True, slots=True)
class Stream:
    """One channel of a recording, under the name that the recording gives it."""

    name: str
    """Topic or feature key, as recorded: `/camera/front`, `observation.state`."""
    kind: StreamKind
    count: int
    """Messages (or rows) in this episode."""
    rate_hz: float | None
    """Median rate; None with fewer than two messages."""
    shape: tuple[int, ...]
    """(height, width) or (height, width, channels) for pictures, (size,) for numbers; () if unknown."""
    encoding: str
    """One of `Encoding` for pictures; the schema or dtype for the rest."""
    schema: str = ""
    names: tuple[str, ...] = ()
    """Names of the components of a numeric stream, as many as `shape[0]`."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong in a recording that could still be opened."""

    where: str
    """File, stream and place: `pick.mcap, /camera/front, message 12`."""
    what: str
    remedy: str
    severity: Literal["warning", "error"] = "warning"

    def __str__(self) -> str:
        return f"{self.where}: {self.what}. {self.remedy}"


@dataclass(frozen=True, slots=True)
class PictureFormat:
    """How the bytes of raw pictures are laid out."""

    width: int
    height: int
    pixel_format: str
    """`rgb8`, `bgr8`, `rgba8`, `bgra8`, `mono8`, `mono16`, `16UC1`, `32FC1` or a Bayer name, as in ROS 2."""
    row_stride: int


@dataclass(frozen=True, slots=True)
class ImageBatch:
    """Pictures of one stream as recorded: undecoded, in decoding order."""

    stream: str
    time_ns: np.ndarray
    """(N,) int64, non-decreasing."""
    data: Sequence[bytes]
    """N encoded pictures: whole JPEG or PNG files, Annex B for H.264/H.265, OBU for AV1, rows for raw."""
    encoding: str
    raw: PictureFormat | None = None
    """Set when, and only when, `encoding == "raw"`."""


@dataclass(frozen=True, slots=True)
class NumericBatch:
    """Numbers of one stream."""

    stream: str
    time_ns: np.ndarray
    """(N,) int64, non-decreasing."""
    values: np.ndarray
    """(N, size) float64; NaN where a message lacks a component."""


Batch = ImageBatch | NumericBatch


@dataclass(frozen=True, slots=True)
class EpisodeRef:
    """An episode as a reader lists it, before anything but its table of contents was read."""

    episode_id: str
    """Safe as a file name; the same from every way to open the same recording in the same folder."""
    title: str
    """What a person would call it: the path inside the source, or `episode 12`."""
    frame_count: int | None = None
    """None when only opening the recording can tell."""
    task: str | None = None
    """The instruction, where the listing knows it."""
    size_bytes: int | None = None
    problem: Problem | None = field(default=None, compare=False)
    """Set when this one cannot be opened; the rest of the source can."""


class Episode(Protocol):
    """One demonstration: streams on one reference clock, read lazily."""

    episode_id: str
    task: str | None
    """The instruction recorded with it, if any."""
    task_id: str | None
    """Id of the task in the catalogue, where the recorder wrote one: several tasks may share an instruction."""
    streams: Mapping[str, Stream]
    """In the recording's order; cameras and numbers that can be read, and the rest as `other`."""
    clock: Clock
    fingerprint: str
    """Changes when the recording's bytes do."""
    problems: Sequence[Problem]
    image_bytes: int
    """Upper bound of the encoded bytes of all pictures: what a viewer must hold."""

    def read(self, streams: Sequence[str] | None = None) -> Iterator[Batch]:
        """Yield the named streams (default: all cameras, depth and numbers) in one pass over the file.

        Memory is bounded by one chunk of the recording. Batches of one stream are in time order;
        batches of different streams interleave roughly by time. Raises SourceError for a name that
        is not there, listing those that are. A picture or message that cannot be decoded is left
        out and recorded in `problems`.
        """
        ...


@runtime_checkable
class ChecksItself(Protocol):
    """An episode that finds damage which opening it does not show."""

    def check(self) -> Sequence[Problem]:
        """Read everything once; gives all problems, those known before included."""
        ...


class EpisodeReader(Protocol):
    """A source of episodes: one file, a folder, a dataset."""

    title: str
    """What the source is, for a person: `3 recordings in demos/`."""
    labels_dir: str
    """Where labels go unless `--labels` says otherwise."""
    problems: Sequence[Problem]
    """Of the source as a whole; those of an episode are on it and on its `EpisodeRef`."""

    def episodes(self) -> Sequence[EpisodeRef]:
        """All episodes in a stable order, without reading more than tables of contents."""
        ...

    def open(self, episode_id: str) -> Episode:
        """Open one. Raises SourceError when it cannot be read or there is none of that id."""
        ...


def loss(episode: Episode) -> Problem | None:
    """A problem for which a part of the recording is missing, so that what it seems to end with may not be its end."""
    return next((problem for problem in episode.problems if problem.severity == "error"), None)


def numbers(episode: Episode, stream: str) -> tuple[np.ndarray, np.ndarray]:
    """All of one numeric stream: times (N,) int64 in nanoseconds and values (N, size) float64."""
    return samples(episode, [stream])[stream]


def samples(episode: Episode, streams: Iterable[str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """As `numbers`, of several streams in one pass over the file, by name; no samples for one that has none."""
    batches: dict[str, list[NumericBatch]] = {name: [] for name in streams}
    for batch in episode.read(list(batches)) if batches else ():
        if isinstance(batch, NumericBatch) and len(batch.time_ns):
            batches[batch.stream].append(batch)
    found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in list(batches):
        some = batches.pop(name)
        time_ns = [b.time_ns for b in some] or [np.empty(0, np.int64)]
        values = [b.values for b in some] or [np.empty((0, *episode.streams[name].shape))]
        found[name] = np.concatenate(time_ns), np.concatenate(values)
    return found
