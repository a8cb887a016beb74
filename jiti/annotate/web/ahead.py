"""Several slow iterators of batches, each worked on in a thread of its own, merged by time."""

import queue
import threading
from collections.abc import Iterator, Sequence

from jiti.episodes.episode import ImageBatch

DEPTH = 2
"""Batches that each iterator may be ahead: enough to keep its thread busy, little to hold."""


class _Ahead:
    """Runs an iterator in a thread; hands its items over in order, and its exception."""

    def __init__(self, items: Iterator[ImageBatch]) -> None:
        self._queue: queue.Queue[ImageBatch | BaseException | None] = queue.Queue(DEPTH)
        self._stopped = threading.Event()
        threading.Thread(target=self._run, args=(items,), daemon=True).start()

    def _run(self, items: Iterator[ImageBatch]) -> None:
        try:
            for item in items:
                self._put(item)
                if self._stopped.is_set():
                    return
            self._put(None)
        except BaseException as error:  # handed to the consumer, which raises it
            self._put(error)

    def _put(self, item: ImageBatch | BaseException | None) -> None:
        while not self._stopped.is_set():
            try:
                self._queue.put(item, timeout=0.2)
                return
            except queue.Full:
                continue

    def next(self) -> ImageBatch | None:
        item = self._queue.get()
        if isinstance(item, BaseException):
            raise item
        return item

    def stop(self) -> None:
        self._stopped.set()


def by_time(sources: Sequence[Iterator[ImageBatch]]) -> Iterator[ImageBatch]:
    """Yield the batches of all sources, always the one that starts earliest. Raises what a source raises."""
    ahead = [_Ahead(source) for source in sources]
    try:
        heads = {worker: batch for worker in ahead if (batch := worker.next()) is not None}
        while heads:
            worker = min(heads, key=lambda w: int(heads[w].time_ns[0]))
            yield heads.pop(worker)
            if (batch := worker.next()) is not None:
                heads[worker] = batch
    finally:
        for worker in ahead:
            worker.stop()
