"""What commands tell a person on the way."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jiti.progress import Progress

if TYPE_CHECKING:
    from jiti.annotate.web.session import Session

QUIET_S = 20.0
"""Longest time without a word where there is no terminal to show a bar on."""


@contextmanager
def progress_bar(what: str) -> Iterator[Progress]:
    """A bar on a terminal, a line every `QUIET_S` elsewhere; called with the share done and what is being done."""
    from time import monotonic

    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    said = monotonic()

    def tell(share: float, now: str) -> None:
        nonlocal said
        if console.is_terminal:
            bar.update(task, completed=share, description=now)
        elif monotonic() - said > QUIET_S:
            said = monotonic()
            print(f"{what}: {share:.0%}, {now}", file=sys.stderr)

    with Bar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)
        yield tell


def say(what: str) -> None:
    print(what, file=sys.stderr)


def until_stopped[T](work: Callable[[], T]) -> T:
    try:
        return work()
    except KeyboardInterrupt:
        say("Stopped. What is finished is kept; the same command goes on there.")
        raise


def say_session(session: "Session") -> None:
    print(f"{session.reader.title}. Labels of {session.annotator} go to {session.store.labels_dir}.")
