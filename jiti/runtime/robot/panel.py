"""What a person at an arm is told and asked, in the terminal and on the page at once; the first key counts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from jiti.runtime.robot.stops import NEXT, STOP, Stops

Phase = Literal["opening", "ready", "running", "asking", "over"]
KEY_NAMES = {NEXT: "Enter", STOP: "Space"}
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Shown:
    """What is on the page."""

    phase: Phase
    text: str
    detail: str = ""
    title: str = ""
    """Which episode this is."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """What each does; Space is always one of them."""
    recording: Path | None = None
    """What is to be looked at."""


class Panel:
    """Asks one thing at a time."""

    def __init__(self, stops: Stops, say: Say, show: Callable[[Shown], None]) -> None:
        self._stops, self._say, self._show = stops, say, show
        self._now = Shown("opening", "")

    def tell(self, shown: Shown) -> None:
        self._now = shown
        self._show(shown)
        self._say(shown.text)

    def remark(self, text: str) -> None:
        """In the midst of what is going on; from any thread."""
        self.tell(replace(self._now, text=text))

    def ask(self, shown: Shown) -> str:
        """The first of the keys that is pressed once it is shown. Raises Stopped."""
        self._now = shown
        self._show(shown)
        self._stops.look()  # what was pressed at the question before
        keys = keys_text(shown.keys) + ("" if self._stops.keys else "  (on the page)")
        self._say("\n".join(line for line in (shown.title, shown.text, shown.detail, keys) if line))
        while (key := self._stops.key()) not in shown.keys:
            pass
        return key


def keys_text(keys: Mapping[str, str]) -> str:
    """`[y] yes  [n] no  [Space] stop`"""
    return "  ".join(f"[{KEY_NAMES.get(key, key)}] {does}" for key, does in {**keys, STOP: "stop"}.items())
