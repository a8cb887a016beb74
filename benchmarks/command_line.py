"""`jiti --help` against importing typer alone."""

import subprocess
import sys
import time
from collections.abc import Iterator

from bench import Bench, interleaved
from machine import command
from report import Line, timed

NAME = "help"
LIMIT = 2.0
REPETITIONS = 21


def measure(bench: Bench) -> Iterator[Line]:
    def run(*arguments: str) -> float:
        start = time.perf_counter()
        subprocess.run(arguments, check=True, capture_output=True)
        return time.perf_counter() - start

    actions = {
        "jiti": lambda: run(command("jiti"), "--help"),
        "typer": lambda: run(sys.executable, "-c", "import typer"),
        "python": lambda: run(sys.executable, "-c", ""),
    }
    interleaved(1, **actions)
    found = interleaved(bench.count(REPETITIONS, 3), **actions)
    peer = timed(NAME, 'peer: python -c "import typer"', found["typer"])
    yield timed(NAME, "python with nothing to do", found["python"])
    yield peer
    yield timed(NAME, "jiti --help", found["jiti"], limit=LIMIT, peer=peer.measured)
