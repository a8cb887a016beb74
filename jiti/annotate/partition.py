"""One annotator's segments of one episode: the only writer of its two files.

An edit is acknowledged when it stands in the history and in the Parquet file, both on the disk. The history is
written first; whatever stops a write in between, opening the partition again makes the two agree.
"""

import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jiti.annotate.folder import aside, history_path, segments_path, write_segments_file
from jiti.annotate.history import Entry, Header, entry_line, header_line
from jiti.annotate.lock import reading, writing
from jiti.annotate.reconcile import Truth, reconcile
from jiti.annotate.segment_file import FileInfo, Recording, encode
from jiti.annotate.segments import Segment
from jiti.annotate.timeline import Timeline
from jiti.durable import save_failed, sync, sync_folder, write_atomic, write_whole
from jiti.episodes.episode import Problem
from jiti.errors import LabelError, SaveFailed, StaleWrite


@dataclass(frozen=True, slots=True)
class View:
    """A partition at one version."""

    version: int
    """How many edits were acknowledged; 0 before the first."""
    segments: tuple[Segment, ...]
    """By start, then end, then id."""
    can_undo: bool
    can_redo: bool


class Partition:
    """Segments as of the last acknowledged edit, and the way to change them. Safe to share among threads.

    Without labels, nothing is created before the first edit.
    """

    def __init__(self, labels_dir: Path, annotator: str, episode_id: str, recording: Recording | None = None) -> None:
        """Open it and make its files agree. `recording` describes the recording as it is now.

        Raises LabelError when the labels are damaged beyond what the two files hold together, NewerSchema
        when a later jiti wrote them.
        """
        self.annotator = annotator
        self.episode_id = episode_id
        self._history = history_path(labels_dir, annotator, episode_id)
        self._parquet = segments_path(labels_dir, annotator, episode_id)
        self._now = recording
        self._mutex = threading.RLock()
        self._seen: tuple[object, ...] | None = None
        self._load()

    @property
    def view(self) -> View:
        """Version, segments and what can be undone, all of the same moment."""
        return self._view

    @property
    def version(self) -> int:
        return self._view.version

    @property
    def segments(self) -> tuple[Segment, ...]:
        return self._view.segments

    @property
    def can_undo(self) -> bool:
        return self._view.can_undo

    @property
    def can_redo(self) -> bool:
        return self._view.can_redo

    @property
    def recording(self) -> Recording | None:
        """The recording that was labelled, as described with the first edit or last confirmed."""
        return self._truth.recording

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What was wrong with the files when they were read, and whether the recording has changed since."""
        then, now = self._truth.recording, self._now
        if then is None or now is None or then.fingerprint == now.fingerprint:
            return self._truth.problems
        changed = Problem(
            str(self._parquet),
            f"the labels were made on a recording of {then.frame_count} frames with fingerprint {then.fingerprint[:8]};"
            f" the one here has {now.frame_count} frames and fingerprint {now.fingerprint[:8]}",
            "Check that the segments still fit and say so with `jiti validate-rewards --confirm`, or open the "
            "recording that they were made on.",
        )
        return (*self._truth.problems, changed)

    def apply(self, action: str, put: Sequence[Segment] = (), remove: Sequence[str] = (), *, based_on: int) -> int:
        """Put rows in (new ones, or in place of those with the same id) and take others out by id; durable on return.

        Gives the new version, or the old one when the edit changes nothing. Raises StaleWrite when `based_on`
        is not the version on the disk, SaveFailed when the disk refuses, LabelError for an edit that makes no
        sense; the labels are then as they were.
        """
        if foreign := [segment for segment in put if segment.episode_id != self.episode_id]:
            raise LabelError(
                f"segment {foreign[0].segment_id} is of episode {foreign[0].episode_id!r}; "
                f"it cannot go to the labels of {self.episode_id!r}"
            )
        return self._write(based_on, lambda timeline, at: timeline.edit_entry(action, put, remove, at))

    def undo(self, *, based_on: int) -> int:
        """Take the last edit back, whenever it was made. Raises like `apply`."""
        return self._write(based_on, lambda timeline, at: timeline.undo_entry(at))

    def redo(self, *, based_on: int) -> int:
        """Make the last undone edit again. Raises like `apply`."""
        return self._write(based_on, lambda timeline, at: timeline.redo_entry(at))

    def confirm(self, recording: Recording, *, based_on: int) -> int:
        """Say that the labels fit a recording whose fingerprint differs from what was labelled. Raises like `apply`."""
        version = self._write(based_on, lambda timeline, at: timeline.recording_entry(recording, at))
        self._now = recording
        return version

    def changes_since(self, version: int) -> list[dict[str, Any]]:
        """Edits after `version`, oldest first: `version`, `at`, `kind`, `action`, `before` and `after` as JSON rows."""
        return self._truth.timeline.since(version)

    def describe(self, recording: Recording | None) -> None:
        """Say how the recording is now, to compare with what was labelled."""
        self._now = recording or self._now

    def refresh(self) -> bool:
        """Take in what another process wrote; whether there was anything. Two `stat` when there was not."""
        with self._mutex:
            if self._signature() == self._seen:
                return False
            before = self.version
            self._load()
            return self.version != before

    def _load(self) -> None:
        with reading(self._history) as descriptor:
            self._read(descriptor)
        if self._truth.needs_repair:
            try:
                with writing(self._history) as descriptor:
                    self._read(descriptor)
                    self._repair(descriptor)
            except SaveFailed as error:
                # The labels can be read all the same: they are whole in memory, and the next save tries again.
                problem = Problem(str(self._parquet), "it could not be repaired", str(error), "error")
                self._truth = replace(self._truth, problems=(*self._truth.problems, problem))

    def _read(self, descriptor: int | None) -> None:
        """Learn what the files hold. The caller has the lock; None when there is no history."""
        self._seen = self._signature()
        data = b"" if descriptor is None else _read_all(descriptor)
        self._truth = reconcile(self._history, data, self._parquet, self.annotator, self.episode_id)
        self._view = _view(self._truth.timeline)

    def _repair(self, descriptor: int) -> None:
        """Make the files agree, under the writer's lock. What was damaged is kept aside. Raises SaveFailed."""
        truth = self._truth
        if truth.parquet_damaged:
            _set_aside(self._parquet)
        if truth.parquet_lags:
            self._write_parquet(self._encoded(truth.timeline.segments(), truth.timeline.version))
        if truth.new_history is not None:
            write_atomic(aside(self._history), _read_all(descriptor))
            # Last, because others can lock the new file as soon as it has the name.
            write_atomic(self._history, truth.new_history, locked=True)
            size = len(truth.new_history)
        elif truth.recovered is not None:
            size = self._append(descriptor, entry_line(truth.recovered))
        else:
            size = truth.history_size
        self._truth = Truth(truth.timeline, truth.recording, size, truth.problems)
        self._seen = self._signature()

    def _write(self, based_on: int, make: Callable[[Timeline, int], Entry | None]) -> int:
        with self._mutex, writing(self._history) as descriptor:
            if self._signature() != self._seen or self._truth.needs_repair:
                self._read(descriptor)
                if self._truth.needs_repair:
                    replaced = self._truth.new_history is not None
                    self._repair(descriptor)
                    if replaced:
                        return self._write(based_on, make)  # this lock is on the old history
            if based_on != self.version:
                raise self._stale(based_on)
            entry = make(self._truth.timeline, time.time_ns())
            if entry is not None:
                self._save(descriptor, entry)
            return self.version

    def _save(self, descriptor: int, entry: Entry) -> None:
        timeline = self._truth.timeline
        recording = entry.recording or self._truth.recording or self._now
        if recording is None:
            raise LabelError(
                f"the first edit of {self.episode_id!r} must say what is labelled; open the partition with a Recording"
            )
        lines = entry_line(entry)
        if self._truth.history_size == 0:
            header = Header(self.annotator, self.episode_id, recording, timeline.version, timeline.segments())
            lines = header_line(header) + lines
        # Everything is encoded before the first byte is written: what cannot be encoded changes nothing.
        data = self._encoded(timeline.segments_with(entry), entry.version, recording)
        size = self._append(descriptor, lines)
        try:
            self._write_parquet(data)
        except SaveFailed:
            self._take_back(descriptor)
            raise
        timeline.append(entry)
        self._truth = replace(self._truth, recording=recording, history_size=size)
        self._seen = self._signature()
        self._view = _view(timeline)

    def _append(self, descriptor: int, lines: bytes) -> int:
        """Add to the history, durably; the new size. Raises SaveFailed, the history then being as it was."""
        size = self._truth.history_size
        try:
            os.ftruncate(descriptor, size)  # drops the rest of a write that was stopped
            os.lseek(descriptor, size, os.SEEK_SET)
            write_whole(descriptor, lines)
            sync(descriptor)
            if size == 0:
                sync_folder(self._history.parent)
        except OSError as error:
            self._take_back(descriptor)
            raise save_failed(self._history, error) from error
        return size + len(lines)

    def _take_back(self, descriptor: int) -> None:
        """Remove an edit that is not acknowledged."""
        self._seen = None  # the files are read again before the next edit
        # A disk that refuses this as well leaves the bytes: a torn line is dropped then, a whole one taken in.
        with suppress(OSError):
            os.ftruncate(descriptor, self._truth.history_size)
            sync(descriptor)

    def _signature(self) -> tuple[object, ...]:
        """Changes when another process writes; ours to compare only under the mutex."""
        return tuple(_stamp(path) for path in (self._history, self._parquet))

    def _encoded(self, segments: Sequence[Segment], version: int, recording: Recording | None = None) -> memoryview:
        recording = recording or self._truth.recording
        recordings = {} if recording is None else {self.episode_id: recording}
        return memoryview(encode(segments, FileInfo(version, self.annotator, recordings)))

    def _write_parquet(self, data: memoryview) -> None:
        write_segments_file(self._parquet, data, locked=True)

    def _stale(self, based_on: int) -> StaleWrite:
        changes = self.changes_since(based_on)
        if based_on > self.version:
            what = f"the page knows version {based_on}, which is not on the disk"
        else:
            last = f", the last one {changes[-1]['action']!r}" if changes else ""
            what = f"{self.version - based_on} edits were saved in between{last}"
        return StaleWrite(
            f"the labels of {self.episode_id!r} by {self.annotator!r} are at version {self.version}, the edit was made "
            f"on version {based_on}: {what}. Nothing was changed. Load the labels again and repeat the edit.",
            changes,
        )


def _view(timeline: Timeline) -> View:
    return View(timeline.version, timeline.segments(), timeline.can_undo, timeline.can_redo)


def _stamp(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise LabelError(f"{path} cannot be opened: {(error.strerror or str(error)).lower()}") from error
    return status.st_dev, status.st_ino, status.st_size


def _read_all(descriptor: int) -> bytes:
    os.lseek(descriptor, 0, os.SEEK_SET)
    with open(descriptor, "rb", closefd=False) as file:
        return file.read()


def _set_aside(path: Path) -> None:
    try:
        path.rename(aside(path))
    except FileNotFoundError:
        return  # another process has just done so
    except OSError as error:
        raise save_failed(path, error) from error
