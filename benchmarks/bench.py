"""What every benchmark is given: where to put files, how large to be, how to show how far it is."""

import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn

LINE_EVERY_S = 15.0
"""Where there is no terminal, progress is a line this often."""

Say = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Bench:
    """`kept` holds what is made once and used again; `quick` asks for sizes that prove nothing but that it runs."""

    kept: Path
    console: Console
    quick: bool = False

    def count(self, real: int, quick: int) -> int:
        return quick if self.quick else real

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """A folder on the same disk that is removed at the end."""
        path = Path(tempfile.mkdtemp(prefix="run-", dir=self.kept))
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)

    @contextmanager
    def progress(self, what: str) -> Iterator[Say]:
        """Call it with the share that is done, and what there is to say."""
        if self.console.is_terminal:
            columns = (*Progress.get_default_columns()[:3], TimeElapsedColumn(), TextColumn("{task.fields[now]}"))
            with Progress(*columns, console=self.console, transient=True) as bar:
                task = bar.add_task(what, total=1.0, now="")
                yield lambda share, now: bar.update(task, completed=share, now=now)
            return
        said_at = time.monotonic()

        def say(share: float, now: str) -> None:
            nonlocal said_at
            if time.monotonic() - said_at > LINE_EVERY_S:
                said_at = time.monotonic()
                print(f"  {what}: {share:.0%} {now}", file=sys.stderr, flush=True)

        yield say


def interleaved(count: int, **actions: Callable[[], float]) -> dict[str, list[float]]:
    """What each action returns, `count` times each, in turn, so that a busy moment hits all of them alike."""
    found: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(count):
        for name, action in actions.items():
            found[name].append(action())
    return found
