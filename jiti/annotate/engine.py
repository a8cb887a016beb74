"""The same function over many episodes: in threads here, or as Ray tasks on one machine or many.

Results come as they are ready; what is made of them must not depend on their order. At most `WAITING` items a worker
are under way, so memory does not grow with the number of episodes. A worker that dies is replaced, and what it was at
is done again.
"""

import logging
import os
import socket
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from itertools import islice
from typing import Literal

from jiti.errors import JitiError, UsageError

Engine = Literal["local", "ray"]
WAITING = 2
"""Items under way for each worker: one that it does, one that is next."""
RAY_RETRIES = 3
"""Times that an item is done again after its worker died. Our choice."""


class WorkerLost(JitiError):
    """Every worker that was given this item died, as when it takes more memory than there is."""


def run[T, R](
    work: Callable[[T], R],
    items: Iterable[T],
    *,
    engine: Engine = "local",
    workers: int | None = None,
    address: str | None = None,
) -> Generator[tuple[T, R | WorkerLost]]:
    """Yield each item with what `work` made of it, in the order in which they are done.

    `work` must be importable (Ray pickles it) and must not raise for an item that is bad. Raises UsageError when Ray is
    not there. Closing the iterator early stops what has not begun.
    """
    if engine == "ray":
        yield from _on_ray(work, items, workers, address)
    else:
        yield from _in_threads(work, items, workers or cores())


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _in_threads[T, R](work: Callable[[T], R], items: Iterable[T], workers: int) -> Generator[tuple[T, R]]:
    rest = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        under_way: dict[Future[R], T] = {pool.submit(work, item): item for item in islice(rest, WAITING * workers)}
        try:
            while under_way:
                done, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for future in done:
                    item = under_way.pop(future)
                    for following in islice(rest, 1):
                        under_way[pool.submit(work, following)] = following
                    yield item, future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _on_ray[T, R](
    work: Callable[[T], R], items: Iterable[T], workers: int | None, address: str | None
) -> Generator[tuple[T, R | WorkerLost]]:
    # Ray reports what is used of it to its makers unless it is told not to.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Under `uv run`, Ray would start its workers through uv again, which builds an environment for each.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    try:
        import ray
        from ray import exceptions
    except ImportError as error:
        raise UsageError("--engine ray needs Ray. Run: pip install 'jiti[ray]'") from error
    if address is not None:
        _check_someone_answers(address)
    started = not ray.is_initialized()
    if started:
        try:
            ray.init(
                address=address or "local",
                num_cpus=None if address else workers or cores(),
                include_dashboard=False,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise UsageError(
                f"no Ray cluster at {address or 'this machine'}: {' '.join(str(error).split())[:200]}. Start one with "
                "`ray start --head`, or leave --ray-address out."
            ) from error
    under_way: dict[object, T] = {}
    try:
        slots = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        shared, task = ray.put(work), ray.remote(max_retries=RAY_RETRIES)(_call)
        rest = iter(items)
        under_way.update({task.remote(shared, item): item for item in islice(rest, WAITING * slots)})
        while under_way:
            done, _ = ray.wait(list(under_way), num_returns=1)
            for reference in done:
                item = under_way.pop(reference)
                for following in islice(rest, 1):
                    under_way[task.remote(shared, following)] = following
                try:
                    result = ray.get(reference)
                except exceptions.RayTaskError:
                    raise  # what `work` itself raised
                except exceptions.RayError as error:
                    result = WorkerLost(f"its worker was lost {RAY_RETRIES + 1} times ({type(error).__name__})")
                yield item, result
    finally:
        for reference in under_way:
            with suppress(exceptions.RayError):
                ray.cancel(reference)
        if started:
            ray.shutdown()


def _check_someone_answers(address: str) -> None:
    """Ray itself tries for a quarter of an hour."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return  # "auto" and the like
    try:
        socket.create_connection((host.strip("[]"), int(port)), 5).close()
    except OSError as error:
        raise UsageError(
            f"no Ray cluster answers at {address} ({error}). Start one with `ray start --head`, or leave --ray-address "
            "out."
        ) from error


def _call[T, R](work: Callable[[T], R], item: T) -> R:
    """Ray takes functions only, and `work` may be any object that can be called."""
    return work(item)
