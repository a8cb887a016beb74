"""Tells a person what to do without waiting: a closed terminal or a full pipe must not keep an arm's torque on."""

from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread

END_S = 0.5
"""In which what is left is said at the end. Our choice."""
Say = Callable[[str], None]


class Teller:
    """`say` in a thread of its own, in order; what it raises is dropped."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        self._thread = Thread(target=self._tell_all, name="teller", daemon=True)
        self._thread.start()

    def __call__(self, said: str) -> None:
        """From any thread; never raises, never blocks."""
        self._queue.put(said)

    def close(self) -> None:
        self._queue.put(None)
        self._thread.join(END_S)

    def _tell_all(self) -> None:
        while (said := self._queue.get()) is not None:
            with suppress(Exception):
                self._say(said)
