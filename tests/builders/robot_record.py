"""`jiti record --robot` as a program of its own, at a terminal whose keys a test presses, or without one."""

import os
import pty
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep

from jiti.runtime.robot.settings import RobotSettings

PORTS = ("kind", "port", "id", "calibration_dir", "leader", "leader_id", "leader_calibration_dir")


def jiti(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "jiti", *arguments]


def environment() -> dict[str, str]:
    """In which a program imports this checkout."""
    path = os.pathsep.join(path for path in sys.path if path)
    return os.environ | {"PYTHONPATH": path, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}


def write_settings(path: Path, settings: RobotSettings) -> str:
    """Of an arm whose cameras are off, for `--robot-config`."""
    lines = [f'{key} = "{getattr(settings, key)}"' for key in PORTS]
    path.write_text("\n".join([*lines, f"release_after_s = {settings.release_after_s}", f"lost_s = {settings.lost_s}"]))
    return str(path)


class Keyboard:
    """A program at a terminal."""

    def __init__(self, program: subprocess.Popen, terminal: int, log: Path) -> None:
        self.program, self._terminal, self._log = program, terminal, log

    def said(self) -> str:
        """All that it has said."""
        return self._log.read_text()

    def wait_for(self, words: str, since: int = 0, seconds: float = 60) -> None:
        end = monotonic() + seconds
        while words not in self.said()[since:]:
            assert monotonic() < end, f"{words!r} was not said: {self.said()}"
            assert self.program.poll() is None or words in self.said()[since:], self.said()
            sleep(0.02)

    def watch(self, true: Callable[[], bool], seconds: float) -> None:
        """Until something is true, while the program runs."""
        end = monotonic() + seconds
        while not true():
            assert monotonic() < end, f"it did not come true: {self.said()}"
            assert self.program.poll() is None, self.said()
            sleep(0.02)

    def press(self, key: str, until_said: str, seconds: float = 60) -> None:
        """And wait for words that come after it. Enter is a carriage return, as in every terminal."""
        before = len(self.said())
        os.write(self._terminal, key.replace("\n", "\r").encode())
        self.wait_for(until_said, before, seconds)


@contextmanager
def at_terminal(command: list[str], log: Path) -> Iterator[Keyboard]:
    """A program whose words go to a file; it is ended in the end, if it has not ended by itself."""
    ours, theirs = pty.openpty()
    with log.open("w") as said:
        program = subprocess.Popen(
            command, stdin=theirs, stdout=said, stderr=subprocess.STDOUT, env=environment(), cwd=log.parent
        )
    try:
        yield Keyboard(program, ours, log)
    finally:
        if program.poll() is None:
            program.terminate()
            program.wait(60)
        os.close(ours)
        os.close(theirs)
