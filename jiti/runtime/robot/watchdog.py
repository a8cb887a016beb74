"""Holds an arm that gets no commands, and then lets it go: what is left of safety when the loop hangs."""

from collections.abc import Callable
from contextlib import suppress
from threading import Event, Thread, current_thread
from time import monotonic

LOOK_S = 0.05


class Watchdog:
    """At work from `start` to `stop`, in a thread of its own."""

    def __init__(
        self, hold: Callable[[], None], let_go: Callable[[], None], *, hold_after_s: float, release_after_s: float
    ) -> None:
        """Both are called once, in this order, `release_after_s` apart, unless a command came in between."""
        self._hold, self._let_go = hold, let_go
        self._hold_after_s, self._release_after_s = hold_after_s, release_after_s
        self._thread: Thread | None = None
        self._ended = Event()
        self.feed()

    def feed(self) -> None:
        """A command came."""
        self._fed_s = monotonic()

    def start(self) -> None:
        self.feed()
        self._ended.clear()
        self._thread = Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """It is over when this returns, except where the watchdog itself calls it."""
        self._ended.set()
        if self._thread is not None and self._thread is not current_thread():
            self._thread.join()
            self._thread = None

    def _watch(self) -> None:
        held = False
        while not self._ended.wait(LOOK_S):
            silent_s = monotonic() - self._fed_s
            if silent_s < self._hold_after_s:
                held = False
            elif not held:
                held = True
                with suppress(Exception):  # it is let go in any case
                    self._hold()
            elif silent_s > self._hold_after_s + self._release_after_s:
                self._ended.set()
                self._let_go()
