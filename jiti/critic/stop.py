"""Ctrl-C and SIGTERM as something that long work looks at between two steps."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Asked:
    """Whether someone asked this process to stop."""

    def __init__(self) -> None:
        self.to_stop = False


@contextmanager
def asked_to_stop() -> Iterator[Asked]:
    """Within it, the first signal to stop is noted and the second one interrupts, as without it.

    Only the main thread hears signals; elsewhere nothing is ever asked.
    """
    asked = Asked()

    def note(number: int, _frame: FrameType | None) -> None:
        if asked.to_stop:
            raise KeyboardInterrupt(f"signal {number}")
        asked.to_stop = True

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
