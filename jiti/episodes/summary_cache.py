"""What is known of recordings from the last time that they were opened, so that a listing need not open them."""

import contextlib
import hashlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import platformdirs

from jiti.durable import make_folder, write_atomic
from jiti.errors import SaveFailed

VERSION = 1


@dataclass(frozen=True, slots=True)
class Summary:
    """Of one recording, as it was with this size and time of change."""

    size_bytes: int
    changed_ns: int
    """Modification time of the file."""
    frame_count: int | None = None
    task: str | None = None
    fingerprint: str | None = None
    problem: tuple[str, str, str] | None = None
    """Where, what and remedy, for a recording that could not be opened."""


class SummaryCache:
    """Summaries by path inside a folder, in one JSON file in the user's cache.

    It is a convenience: a file that is damaged, of another version, or cannot be written is as good as none.
    """

    def __init__(self, root: Path) -> None:
        key = hashlib.sha256(os.fsencode(root.resolve())).hexdigest()[:24]
        self.path = platformdirs.user_cache_path("jiti") / "summaries" / f"{key}.json"
        self._known = self._load()

    def get(self, inside: str, stat: os.stat_result) -> Summary | None:
        """The summary of the file at this path, if it has not changed since."""
        known = self._known.get(inside)
        if known is None or (known.size_bytes, known.changed_ns) != (stat.st_size, stat.st_mtime_ns):
            return None
        return known

    def put(self, inside: str, summary: Summary) -> None:
        if self._known.get(inside) == summary:
            return
        self._known = {**self._load(), **self._known, inside: summary}
        rows = {name: asdict(known) for name, known in self._known.items()}
        text = json.dumps({"version": VERSION, "recordings": rows})
        with contextlib.suppress(SaveFailed, OSError, UnicodeEncodeError):
            make_folder(self.path.parent)
            write_atomic(self.path, text.encode())

    def _load(self) -> dict[str, Summary]:
        try:
            content = json.loads(self.path.read_bytes())
            if content["version"] != VERSION:
                return {}
            return {str(name): _summary(row) for name, row in content["recordings"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {}


def _summary(row: dict[str, Any]) -> Summary:
    """Raises TypeError or ValueError for a row that this version did not write."""
    known = Summary(**row)
    numbers = (known.size_bytes, known.changed_ns, known.frame_count or 0)
    texts = (known.task or "", known.fingerprint or "", *(known.problem or ()))
    if not all(type(n) is int for n in numbers) or not all(type(t) is str for t in texts):
        raise TypeError("a field has a wrong type")
    if known.problem is not None and len(known.problem) != 3:
        raise ValueError("a problem has three parts")
    return Summary(**{**row, "problem": tuple(known.problem) if known.problem else None})
