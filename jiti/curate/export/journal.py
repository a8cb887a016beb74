"""What a run has finished so far, so that one that was stopped goes on: a folder beside the dataset's place.

<name>.partial/plan.json         the digest of all inputs: another one starts anew
<name>.partial/journal.jsonl     one line for each finished episode, in order
<name>.partial/pieces/           files of episodes that are in none of LeRobot's files yet
<name>.partial/dataset/          what will be there in the end
"""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jiti.curate.export.meta import stats_from_json, stats_to_json
from jiti.curate.export.stats import Stats
from jiti.durable import make_folder, sync, sync_file, write_atomic, write_whole
from jiti.errors import UsageError

FORMAT = 1
"""Of these files; another one starts anew."""


@dataclass(frozen=True, slots=True)
class Done:
    """One finished episode."""

    index: int
    data_bytes: int
    """Of its rows as a file."""
    videos: Mapping[str, "DoneVideo"]
    """By feature."""
    stats: Mapping[str, Stats]
    notes: tuple[str, ...]
    """What a person should know of it."""


@dataclass(frozen=True, slots=True)
class DoneVideo:
    """One finished video."""

    size_bytes: int
    kind: str
    """Videos of one kind can stand in one file: codec, its settings, size of the pictures."""
    info: Mapping[str, Any]
    """What lerobot's info.json says of it."""


class Journal:
    """Append-only, one process at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "journal.jsonl"
        self._offsets: list[int] = []
        """Where each line begins, so that episodes need not stay in memory."""
        self._end = 0
        self._lock = -1

    @classmethod
    def open(cls, folder: Path, digest: str) -> "Journal":
        """Go on with what a run of the same inputs left, or start anew.

        Raises UsageError while another process writes there, SaveFailed.
        """
        make_folder(folder)
        lock = _locked(folder)
        about = {"format": FORMAT, "digest": digest}
        plan = folder / "plan.json"
        try:
            same = json.loads(plan.read_text()) == about
        except (OSError, ValueError):
            same = False
        if not same:
            for path in folder.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            write_atomic(plan, json.dumps(about).encode())
        journal = cls(folder)
        journal._lock = lock
        journal.dataset.mkdir(exist_ok=True)
        (folder / "pieces").mkdir(exist_ok=True)
        journal._find_lines()
        return journal

    def close(self) -> None:
        """Let another process write there."""
        os.close(self._lock)

    @property
    def dataset(self) -> Path:
        return self._folder / "dataset"

    @property
    def finished(self) -> int:
        """Episodes."""
        return len(self._offsets)

    def piece(self, index: int, name: str) -> Path:
        """Where a file of an episode is until it is joined with others."""
        return self._folder / "pieces" / f"{index:06d}.{name}"

    def done(self, index: int) -> Done | None:
        """What was finished of an episode; None when nothing was."""
        return self._read(index) if index < len(self._offsets) else None

    def all(self) -> Iterator[Done]:
        """Every finished episode, one at a time."""
        for index in range(len(self._offsets)):
            yield self._read(index)

    def add(self, done: Done) -> Done:
        """Note the next episode as finished; its files are on the disk before the note is."""
        for path in (self._folder / "pieces").glob(f"{done.index:06d}.*"):
            sync_file(path)
        told = {
            "index": done.index,
            "data_bytes": done.data_bytes,
            "videos": {key: [v.size_bytes, v.kind, dict(v.info)] for key, v in done.videos.items()},
            "stats": stats_to_json(done.stats),
            "notes": done.notes,
        }
        line = json.dumps(told).encode() + b"\n"
        descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            os.ftruncate(descriptor, self._end)  # drops the rest of a note that was cut off
            os.lseek(descriptor, self._end, os.SEEK_SET)
            write_whole(descriptor, line)
            sync(descriptor)
        finally:
            os.close(descriptor)
        self._offsets.append(self._end)
        self._end += len(line)
        return done

    def _find_lines(self) -> None:
        if not self._path.exists():
            return
        with self._path.open("rb") as file:
            for line in file:
                if not line.endswith(b"\n"):
                    break
                self._offsets.append(self._end)
                self._end += len(line)

    def _read(self, index: int) -> Done:
        with self._path.open("rb") as file:
            file.seek(self._offsets[index])
            told = json.loads(file.readline())
        videos = {key: DoneVideo(*video) for key, video in told["videos"].items()}
        return Done(told["index"], told["data_bytes"], videos, stats_from_json(told["stats"]), tuple(told["notes"]))


def _locked(folder: Path) -> int:
    """A descriptor that keeps other processes out until it is closed."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise UsageError(f"another jiti curate writes in {folder}. Wait for it, or pass another --out.") from None
    return descriptor
