"""One writer a file, across threads and processes."""

import errno
import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jiti.durable import make_folder, save_failed
from jiti.errors import LabelError, SaveFailed

PATIENCE_S = 10.0
"""How long to wait for another writer. Our choice: a save takes milliseconds, so this one is stuck."""


@contextmanager
def writing(path: Path) -> Iterator[int]:
    """The file at `path`, open and locked for one writer; it and its folder are created.

    Raises SaveFailed when the disk or another process does not let us.
    """
    make_folder(path.parent)
    with _locked(path, os.O_RDWR | os.O_CREAT, fcntl.LOCK_EX) as descriptor:
        yield descriptor


@contextmanager
def reading(path: Path) -> Iterator[int | None]:
    """The file at `path`, open and locked against writers; None when there is none. Raises LabelError."""
    try:
        there = path.exists()
    except OSError as error:
        raise LabelError(f"{path} cannot be opened: {(error.strerror or str(error)).lower()}") from error
    if not there:
        yield None
        return
    with _locked(path, os.O_RDONLY, fcntl.LOCK_SH) as descriptor:
        yield descriptor


@contextmanager
def _locked(path: Path, flags: int, mode: int) -> Iterator[int]:
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            descriptor = os.open(path, flags | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise save_failed(path, error) from error
        try:
            _wait(descriptor, path, mode, deadline)
            if _is_at(descriptor, path):
                yield descriptor
                return
        finally:
            os.close(descriptor)


def _wait(descriptor: int, path: Path, mode: int, deadline: float) -> None:
    pause_s = 0.0002
    while True:
        try:
            return fcntl.flock(descriptor, mode | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EINTR):
                raise save_failed(path, error) from error
        if time.monotonic() > deadline:
            raise SaveFailed(
                f"{path} is locked by another process for more than {PATIENCE_S:.0f} s. Nothing was changed. "
                "Look for a stopped `jiti annotate`, end it, and try again."
            )
        time.sleep(pause_s)
        pause_s = min(2 * pause_s, 0.01)


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether the path still names the open file: another process may have replaced it while we waited."""
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(descriptor), there)
