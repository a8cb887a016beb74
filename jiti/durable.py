"""Writes that are there in whole or not at all, also after a kill or a power cut."""

import errno
import fcntl
import os
import secrets
from collections.abc import Buffer, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from jiti.errors import SaveFailed

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_CLOSED = {errno.EROFS, errno.EACCES, errno.EPERM}
_FULL_SYNC: int | None = getattr(fcntl, "F_FULLFSYNC", None)
"""macOS only: its fsync leaves the data in the drive's own cache."""


def save_failed(path: Path, error: OSError) -> SaveFailed:
    """The error for a person, after the disk refused to write `path`."""
    if error.errno in _FULL:
        remedy = "Free some space and save again"
    elif error.errno in _CLOSED:
        remedy = "Make the folder writable, or name another one with --labels, and save again"
    else:
        remedy = "Check the disk and save again"
    reason = (os.strerror(error.errno) if error.errno else str(error)).lower()
    return SaveFailed(f"{path} could not be saved: {reason}. Nothing that was saved before is lost. {remedy}.")


def sync(descriptor: int) -> None:
    """Flush a file to the disk itself."""
    if _FULL_SYNC is None:
        os.fsync(descriptor)
    else:
        fcntl.fcntl(descriptor, _FULL_SYNC)


def sync_file(path: Path) -> None:
    """Flush a file that was written elsewhere to the disk itself."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        sync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable: what was created, renamed or removed in it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        sync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot, and write names at once
            raise
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and the parents that it lacks, durably. Raises SaveFailed."""
    missing = [folder]
    try:
        while not missing[-1].exists() and missing[-1] != missing[-1].parent:
            missing.append(missing[-1].parent)
        for path in reversed(missing[:-1]):
            path.mkdir(exist_ok=True)
            sync_folder(path.parent)
        folder.mkdir(exist_ok=True)  # says so when something else has that name
    except OSError as error:
        raise save_failed(folder, error) from error


def write_whole(descriptor: int, data: Buffer) -> None:
    """Write every byte, also where the system takes only some at a time."""
    rest = memoryview(data).cast("B")
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def write_atomic(path: Path, data: Buffer, *, locked: bool = False) -> None:
    """Replace a file's content: readers see the old bytes or the new ones, and the new ones are on the disk on return.

    With `locked`, the caller holds a lock for `path`: the temporary file then has a fixed name, so that one
    that a killed process left is overwritten. Raises SaveFailed; the old content is then still there, or,
    where only the last flush failed, the new one.
    """
    temporary = path.with_name(f".{path.name}.tmp") if locked else _unique(path)
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
        try:
            write_whole(descriptor, data)
            sync(descriptor)
        finally:
            os.close(descriptor)
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):  # the disk that refused the write may refuse this as well
            temporary.unlink(missing_ok=True)
        raise save_failed(path, error) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` for writers that want a path; it takes the place of `path` at the end.

    After an exception the temporary file is gone and `path` as it was. Raises SaveFailed for errors of the disk.
    """
    temporary = _unique(path)
    try:
        yield temporary
        descriptor = os.open(temporary, os.O_RDONLY | os.O_CLOEXEC)
        try:
            sync(descriptor)
        finally:
            os.close(descriptor)
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise save_failed(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _unique(path: Path) -> Path:
    # Ends like the target, because writers choose a format by it; starts with a dot, because dataset readers skip that.
    return path.with_name(f".tmp-{os.getpid()}-{secrets.token_hex(4)}-{path.name}")
