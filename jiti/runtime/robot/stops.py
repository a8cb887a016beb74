"""How a person or the system stops an arm: Space, and the signals that end a program; and a person's other keys.

While an arm has torque, a signal raises nothing in the middle of an exchange with the servos: it is asked for at each
step. Otherwise it ends the program as usual.
"""

import os
import select
import signal
import sys
import termios
import tty
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import sleep
from types import FrameType
from typing import Self

SIGNALS = (
    *(signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
    signal.SIGQUIT,  # would end the program with the torque on
    *(signal.SIGTSTP, signal.SIGTTIN),  # would suspend it, and the watchdog with it
)
STOP, NEXT = " ", "\n"
"""Space ends everything, Enter the episode."""
_CARRIAGE_RETURN = "\r"
"""What Enter sends where the terminal does not make a new line of it: Python 3.12.1's `setcbreak` has it not to."""
LOOK_S = 0.02
"""Between two looks at the keys while a person thinks."""


class Stopped(Exception):
    """The arm is to stop at once."""

    def __init__(self, why: str, exit_code: int) -> None:
        """`exit_code` is what the program ends with: 128 and the signal's number, or 0."""
        super().__init__(why)
        self.exit_code = exit_code


class Stops:
    """With `with`, signals and the terminal's keys are listened to; after it all is as before."""

    def __init__(self, *, keys: bool = True) -> None:
        """`keys`: those of a terminal, where standard input is one."""
        self.keys = keys and sys.stdin is not None and sys.stdin.isatty()
        self._pressed: deque[str] = deque()
        self._stop = False
        self._signal: int | None = None
        self._guarded = False

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._heard) for number in SIGNALS}
        if self.keys:
            self._terminal = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self.keys:
            with suppress(termios.error):  # a terminal that is gone
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """While an arm has torque: signals are told by `look`, and what is left of them by this at the end.

        Raises Stopped."""
        self._guarded = True
        try:
            yield
        finally:
            self._guarded = False
        self._raise_signal()

    def press(self, key: str) -> None:
        """As if it had been pressed in the terminal; from any thread. Space is never forgotten."""
        if key == STOP:
            self._stop = True
        else:
            self._pressed.append(NEXT if key == _CARRIAGE_RETURN else key)

    def look(self) -> bool:
        """Whether the episode is to end; keys are forgotten. Raises Stopped where everything is to."""
        return NEXT in self.pressed()

    def pressed(self) -> list[str]:
        """Keys since they were asked for last. Raises like `look`."""
        self._take_keys()
        return [self._pressed.popleft() for _ in range(len(self._pressed))]

    def key(self) -> str:
        """The next one, which is waited for. Raises Stopped where that is Space, or a signal comes."""
        self._take_keys()
        while not self._pressed:
            sleep(LOOK_S)
            self._take_keys()
        return self._pressed.popleft()

    def _take_keys(self) -> None:
        self._raise_signal()
        for key in self._typed():
            self.press(key)
        if self._stop:
            raise Stopped("stopped by Space", 0)

    def _raise_signal(self) -> None:
        if self._signal is not None:
            number, self._signal = self._signal, None
            raise Stopped(f"stopped by {signal.Signals(number).name}", 128 + number)

    def _typed(self) -> str:
        if not self.keys or not _in_front() or not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        try:
            typed = os.read(sys.stdin.fileno(), 1024)
        except OSError:
            typed = b""
        if not typed:
            raise Stopped("stopped, because the terminal is gone", 128 + signal.SIGHUP)
        return typed.decode(errors="ignore")

    def _heard(self, number: int, _frame: FrameType | None) -> None:
        self._signal = number
        if not self._guarded:
            self._raise_signal()


def _in_front() -> bool:
    """Whether a key may be read: in the background each try is answered with SIGTTIN."""
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # not the terminal that controls this program
        return True
