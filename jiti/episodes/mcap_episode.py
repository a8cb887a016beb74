"""An MCAP recording as an episode."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jiti.episodes.clock import Clock, fixed_rate
from jiti.episodes.episode import INTER_CODED, Batch, Problem, Stream
from jiti.episodes.mcap_contents import Contents
from jiti.episodes.mcap_decode import SUPPORTED
from jiti.episodes.mcap_problems import chunk_losses, late_problem, loss_problems, read_problems, stream_problems
from jiti.episodes.mcap_read import Fault, Faults, read_streams
from jiti.episodes.mcap_records import MAGIC, MAX_UNPACKED_BYTES, McapFile, RecordDamaged, unpack
from jiti.episodes.mcap_scan import read_unindexed
from jiti.episodes.mcap_streams import (
    McapStream,
    Sampler,
    frame_rate_of,
    own_metadata,
    put_in_order,
    streams_of,
    task_of,
)
from jiti.episodes.mcap_summary import NoSummary, read_indexed
from jiti.errors import SourceError

if TYPE_CHECKING:
    import av

FINGERPRINT_BYTES = 1 << 20
"""The fingerprint covers so many bytes at either end. Our choice: header and first chunk, last chunk and summary."""
FEW_MESSAGES = 3
"""Streams with fewer messages are latched: they do not say when the recording took place. Our choice."""
APART_NS = 3600 * 10**9
"""Messages this far from the bulk do not count for the clock. Our choice: no demonstration pauses for an hour."""
LATE_PERIODS = 5
LATE_NS = 500_000_000
"""A stream is late where its latest message is older than five of its periods and half a second. Our choice."""


class McapEpisode:
    """One MCAP file. Times are its log times, in which clock jumps are undone.

    `fingerprint` covers the file's size and its first and last MiB: a change of bytes in between that keeps the size
    goes unnoticed, which no recorder or converter does.
    """

    def __init__(self, path: Path, episode_id: str) -> None:
        """Raises SourceError when nothing in the file can be read."""
        self.episode_id = episode_id
        self.path = path
        with McapFile(path) as file:
            self._stamp = file.stamp
            self._contents = read_contents(file)
            found = streams_of(self._contents)
            Sampler(file, self._contents).sample(found)
            self.fingerprint = _fingerprint(file)
        put_in_order(found)
        self._streams = {stream.name: stream for stream in found}
        self.streams: Mapping[str, Stream] = {stream.name: stream.describe() for stream in found}
        self.task = task_of(self._contents, found)
        self.metadata = own_metadata(self._contents)
        """What jiti's recorder wrote of the episode; empty for recordings of others."""
        self.task_id = self.metadata.get("task")
        self.clock = _clock(found, frame_rate_of(self._contents))
        self.image_bytes = _image_bytes(self._contents, found)
        self._faults = Faults()
        self._opening_problems = self._find_problems()
        self.problems: Sequence[Problem] = self._opening_problems
        """What opening found, and, after each pass, what reading has found."""

    def read(self, streams: Sequence[str] | None = None) -> Iterator[Batch]:
        """Yield the named streams, or all cameras, depth and numbers, in one pass. See `Episode.read`.

        Memory: one chunk, and what is held back where chunks overlap in time.
        """
        readable = [name for name, stream in self.streams.items() if stream.kind != "other"]
        wanted = readable if streams is None else list(dict.fromkeys(streams))
        for name in wanted:
            if name not in self._streams:
                known = ", ".join(readable) or "none"
                raise SourceError(f"{self.path.name} has no stream {name!r}; it has: {known}.")
            if name not in readable:
                reason = self._streams[name].reading.unsupported or "it holds neither pictures nor numbers"
                raise SourceError(f"{self.path.name}, {name}: it cannot be read: {reason}. Readable are: {readable}.")
        return self._read([self._streams[name] for name in wanted])

    def _read(self, streams: Sequence[McapStream]) -> Iterator[Batch]:
        faults = Faults()
        try:
            with self._opened() as file:
                yield from read_streams(file, self._contents, streams, faults)
        finally:
            self._found(faults)

    def decode(self, stream: str, frames: Sequence[int]) -> "Iterator[tuple[int, av.VideoFrame]] | None":
        """Single pictures without a pass over the file; see `jiti.episodes.video.DecodesItself`.

        None for video, whose pictures need those before them.
        """
        known = self.streams.get(stream)
        if known is None or known.kind not in ("camera", "depth") or known.encoding in INTER_CODED:
            return None
        return self._decode(self._streams[stream], frames)

    def _decode(self, stream: McapStream, frames: Sequence[int]) -> "Iterator[tuple[int, av.VideoFrame]]":
        from jiti.episodes.mcap_frames import decode_stills

        with self._opened() as file:
            yield from decode_stills(file, self._contents, stream, self.clock, frames)

    def _opened(self) -> McapFile:
        """The file, which must be as it was when the episode was opened."""
        file = McapFile(self.path)
        if file.stamp != self._stamp:
            file.close()
            raise SourceError(f"{self.path} changed since it was opened. Open it again.")
        return file

    def check(self) -> Sequence[Problem]:
        """Unpack every chunk once, so that `problems` names all that are corrupt; returns them."""
        faults = Faults()
        known = {loss.chunk for loss in self._contents.losses}
        with self._opened() as file:
            for chunk in self._contents.chunks:
                if chunk.number in known:
                    continue
                try:
                    unpack(file, chunk)
                except RecordDamaged as error:
                    faults.chunks[chunk.number] = str(error)
        self._found(faults)
        return self.problems

    def _found(self, faults: Faults) -> None:
        """Take in what a pass found wrong."""
        self._faults = _merged(self._faults, faults)
        losses = chunk_losses(self._contents, list(self._streams.values()), self._faults.chunks)
        self.problems = [
            *self._opening_problems,
            *loss_problems(self.path.name, self._contents, losses, self._start_log_ns),
            *read_problems(self.path.name, self._streams, self._faults, int(self.clock.frame_ns[0])),
        ]

    @property
    def _start_log_ns(self) -> int:
        """Log time that counts as 0 s in problems: that of the clock's first frame."""
        reference = self._streams.get(self.clock.reference or "")
        return int(reference.rows.time_ns[0]) if reference else int(self.clock.frame_ns[0])

    def _find_problems(self) -> list[Problem]:
        name, streams = self.path.name, list(self._streams.values())
        problems = loss_problems(name, self._contents, self._contents.losses, self._start_log_ns)
        problems += stream_problems(name, streams, SUPPORTED)
        for stream in streams:
            if stream.kind == "other" or stream.name == self.clock.reference or len(stream.time_ns) < FEW_MESSAGES:
                continue
            tolerance = max(LATE_NS, LATE_PERIODS * stream.period_ns)
            late = self.clock.late_frames(stream.time_ns, tolerance)
            if stream.time_ns[0] - self.clock.frame_ns[0] <= tolerance:
                late = late[self.clock.frame_ns[late] >= stream.time_ns[0]]  # no two streams start at one instant
            if len(late):
                problems.append(late_problem(f"{name}, {stream.name}", late, self.clock.frame_count, tolerance))
        if all(stream.kind == "other" for stream in streams):
            what = "it has neither pictures nor numbers that can be read; there is nothing to show"
            problems.append(Problem(name, what, f"Record cameras and joints as one of these: {SUPPORTED}", "error"))
        return problems


def read_contents(file: McapFile) -> Contents:
    """The table of contents of a file. Raises SourceError when it is no MCAP file or nothing in it can be read."""
    path, again = file.path, "Copy it from its source again, or record it again."
    if file.size == 0:
        raise SourceError(f"{path} is empty (0 bytes). {again}")
    start = file.read(0, min(file.size, len(MAGIC)))
    if start != MAGIC:
        if MAGIC.startswith(start):
            raise SourceError(f"{path} ends after {file.size} bytes, before its first record. {again}")
        raise SourceError(
            f"{path} is not an MCAP file: it starts with {start.hex(' ')} and not with {MAGIC.hex(' ')}. "
            "Pass a recording in the MCAP format."
        )
    try:
        contents = read_indexed(file)
    except NoSummary as reason:
        contents = read_unindexed(file, str(reason))
    if not any(len(rows.time_ns) for rows in contents.rows.values()):
        found = "; ".join(f"{loss.where} {loss.what}" for loss in contents.losses)
        declared = ", ".join(channel.topic for channel in contents.channels.values()) or "none"
        why = f"what was found: {found}" if found else f"channels declared: {declared}"
        raise SourceError(f"{path} has no messages that can be read; {why}. {again}")
    return contents


def _image_bytes(contents: Contents, streams: Sequence[McapStream]) -> int:
    """Upper bound of the bytes of all pictures: the room between their records and the next ones."""
    cameras = [s for s in streams if s.reading.role == "picture" and len(s.rows.chunk)]
    if not cameras:
        return 0
    # A corrupt chunk can declare any size.
    ends = np.array([c.number << 32 | min(c.unpacked_size, MAX_UNPACKED_BYTES) for c in contents.chunks], np.int64)
    every = np.sort(np.concatenate([ends, *(_places(s) for s in streams)]))
    return sum(int((every[np.searchsorted(every, _places(s), side="right")] - _places(s)).sum()) for s in cameras)


def _places(stream: McapStream) -> np.ndarray:
    """Chunk and offset of each message as one number, (N,) int64."""
    return stream.rows.chunk.astype(np.int64) << 32 | stream.rows.offset


def _fingerprint(file: McapFile) -> str:
    digest = hashlib.blake2b(file.size.to_bytes(8, "little"), digest_size=16)
    digest.update(file.read(0, min(file.size, FINGERPRINT_BYTES)))
    tail = max(0, file.size - FINGERPRINT_BYTES)
    digest.update(file.read(tail, file.size - tail))
    return digest.hexdigest()


def _clock(streams: Sequence[McapStream], rate_hz: float) -> Clock:
    """The first camera's pictures, else the first depth camera's, else a fixed rate over the numbers."""
    for kind in ("camera", "depth"):
        for stream in streams:
            if stream.kind == kind:
                return Clock(stream.name, stream.time_ns)
    numeric = [s.time_ns for s in streams if s.kind == "numeric"]
    enough = [t for t in numeric if len(t) >= FEW_MESSAGES]
    times = np.sort(np.concatenate(enough or numeric or [s.time_ns for s in streams]))
    bulk = max(np.split(times, np.flatnonzero(np.diff(times) > APART_NS) + 1), key=len)
    return fixed_rate(int(bulk[0]), int(bulk[-1]), rate_hz)


def _merged(old: Faults, new: Faults) -> Faults:
    """What all passes found; of the same fault, the pass that saw most of it."""

    def most(first: dict[str, Fault], second: dict[str, Fault]) -> dict[str, Fault]:
        either = {**first, **second}
        return {n: max((f[n] for f in (first, second) if n in f), key=lambda fault: fault.count) for n in either}

    return Faults(
        {**old.chunks, **new.chunks},
        most(old.left_out, new.left_out),
        most(old.other_format, new.other_format),
        {**old.missing, **new.missing},
        {**old.unknown, **new.unknown},
    )
