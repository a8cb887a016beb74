"""The same work over many episodes in processes of their own, which stop when told and end with the one that asked.

Processes are spawned: MuJoCo holds the interpreter, and its renderers do not survive a fork. Work is a function that
can be imported; it calls `check_stop` often, and keeps what it opened in its own module.
"""

import fcntl
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from jiti.errors import UsageError

GRACE_S = 5.0
"""Our choice: a step with pictures takes 0.3 s on a slow machine."""


class Stopped(Exception):
    """Ends an episode that no one waits for any more."""


@contextmanager
def alone(folder: Path, command: str) -> Iterator[None]:
    """Keep other runs out of a folder until the end; the system lets it go when this process ends, however it ends.

    Raises UsageError, which names the command, while another run is at work there.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise UsageError(f"another `{command}` is at work in {folder}. Wait for it, or pass another --out.") from None
    try:
        yield
    finally:
        os.close(descriptor)


def remove_leftovers(folder: Path, names: Iterable[str]) -> None:
    """Unfinished files of these names, of runs that were killed; no run goes on in this folder now."""
    names = set(names)
    for path in folder.glob(".tmp-*"):
        found = re.fullmatch(r"\.tmp-(\d+)-[0-9a-f]+-(.+)", path.name)
        if found and found[2] in names:
            with suppress(OSError):
                path.unlink()


def in_processes[T, R](
    work: Callable[[T], R], items: Sequence[T], workers: int, name: Callable[[T], str]
) -> Generator[tuple[T, R]]:
    """Yield each item with what `work` made of it, in the order in which they are done.

    `name` says what an item is, for a person. Raises what `work` raises, and UsageError that names the item when its
    process was ended from outside; the others are then stopped, and what they had finished was yielded or is on the
    disk. So are they when the iterator is closed.
    """
    context = multiprocessing.get_context("spawn")
    stop, joined = context.Event(), context.Value("i", 0)
    # Of each worker its process id, and the place of its item in `items`, from 1. Without a lock, which a worker that
    # is killed would keep.
    at_work = context.Array("q", 2 * workers, lock=False)
    with ProcessPoolExecutor(workers, context, _begin, (stop, joined, at_work)) as pool:
        with _ignoring_interrupts():  # which workers inherit: Ctrl-C reaches every process of a terminal
            jobs = {pool.submit(_do, work, item, place): item for place, item in enumerate(items, start=1)}
            processes = multiprocessing.active_children()
        try:
            for job in as_completed(jobs):
                yield jobs[job], job.result()
        except BrokenProcessPool as error:
            lost = _lost(processes, at_work)
            what = " or ".join(name(items[place - 1]) for place in lost) if lost else "what it was at"
            raise UsageError(
                f"the process at work on {what} was ended from outside, perhaps for want of memory. What is finished "
                "is kept: run the same command again, with fewer --workers."
            ) from error
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            _end_soon(processes)
            raise


def check_stop() -> None:
    """Raises Stopped in a worker that is to end; does nothing in any other process."""
    if _stop is not None and _stop.is_set():
        raise Stopped


def _lost(processes: Sequence[BaseProcess], at_work: Any) -> list[int]:
    """Places of the items whose processes did not end by themselves; the pool ends the others by SIGTERM."""
    # Not joined: the pool's own thread waits for them too, and who comes second is told nothing until it has noted it.
    end = time.monotonic() + GRACE_S
    while any(process.exitcode is None for process in processes) and time.monotonic() < end:
        time.sleep(0.01)
    killed = {p.pid for p in processes if p.exitcode not in (None, 0, -signal.SIGTERM)}
    rows = [(at_work[k], at_work[k + 1]) for k in range(0, len(at_work), 2)]
    busy = {pid: place for pid, place in rows if place}
    return [place for pid, place in busy.items() if pid in killed] or list(busy.values())


def _end_soon(workers: Sequence[BaseProcess]) -> None:
    """Give each worker a moment to take its unfinished file away, and end those that build a scene meanwhile."""
    end = time.monotonic() + GRACE_S
    for worker in workers:
        worker.join(max(0.0, end - time.monotonic()))
        if worker.is_alive():
            worker.terminate()


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


_stop: Any = None
_at_work: Any = None
_slot = 0


def _begin(stop: Any, joined: Any, at_work: Any) -> None:
    global _stop, _at_work, _slot
    with joined.get_lock():
        _slot = joined.value
        joined.value += 1
    _stop, _at_work = stop, at_work
    _at_work[2 * _slot] = os.getpid()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _do[T, R](work: Callable[[T], R], item: T, place: int) -> R:
    _at_work[2 * _slot + 1] = place
    done = work(item)
    _at_work[2 * _slot + 1] = 0
    return done


def _end_with_parent() -> None:
    """When the process that asked was killed, no one takes work from this one or ends it: finish here."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        _stop.set()
        time.sleep(GRACE_S)  # in which an episode that is under way takes its unfinished file away
        os._exit(1)
