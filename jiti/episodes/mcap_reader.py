"""One MCAP file as a source of episodes."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote_from_bytes

from jiti.episodes.episode import EpisodeRef, Problem
from jiti.episodes.mcap_episode import McapEpisode
from jiti.episodes.mcap_records import MAGIC
from jiti.errors import SourceError

SUFFIX = ".mcap"
MAX_ID_BYTES = 180
"""Longest episode id. Our choice: with `.parquet` or a temporary file's prefix it fits the 255 bytes of a file name."""


def mcap_episode_id(path: Path, root: Path) -> str:
    """Id of the recording at `path` in the opened folder `root`: safe as a file name, and no other recording's.

    The path inside the folder without `.mcap`, percent-encoded, also a leading dot; a long one ends in a hash.
    """
    inside = os.fsencode(_inside(path, root))
    name = inside.removesuffix(SUFFIX.encode())
    # Quoting never leaves a bare "%", so another suffix has an id of its own.
    quoted = quote_from_bytes(name, safe="") + ("" if name != inside else "%")
    if quoted.startswith("."):
        quoted = "%2E" + quoted[1:]
    if len(quoted) > MAX_ID_BYTES:
        digest = hashlib.blake2b(inside, digest_size=16).hexdigest()
        quoted = f"{quoted[: MAX_ID_BYTES - len(digest) - 2]}%%{digest}"
    return quoted


def _inside(path: Path, root: Path) -> Path:
    path, root = path.absolute(), root.absolute()
    return path.relative_to(root) if path.is_relative_to(root) else Path(path.name)


class McapReader:
    """Opens one recording. Listing it reads no more than its first bytes.

    `root` is the folder that was opened when the recording is one of many; it decides the episode's id.
    """

    def __init__(self, path: Path, *, root: Path | None = None) -> None:
        self.path = path
        self._root = root if root is not None else path.absolute().parent
        self.title = path.name
        self.labels_dir = str(self._root / "labels")
        self.problems: Sequence[Problem] = ()
        self._episode_id = mcap_episode_id(path, self._root)

    def episodes(self) -> Sequence[EpisodeRef]:
        title = str(_inside(self.path, self._root))
        try:
            size = self.path.stat().st_size
            with self.path.open("rb") as file:
                start = file.read(len(MAGIC))
        except OSError as error:
            what = f"it cannot be read ({(error.strerror or str(error)).lower()})"
            problem = Problem(title, what, "Check the path and its permissions", "error")
            return [EpisodeRef(self._episode_id, title, problem=problem)]
        problem = None
        if start != MAGIC:
            what = "it is empty (0 bytes)" if not size else "it does not start like an MCAP file"
            problem = Problem(title, what, "Copy it from its source again, or record it again", "error")
        return [EpisodeRef(self._episode_id, title, size_bytes=size, problem=problem)]

    def open(self, episode_id: str) -> McapEpisode:
        if episode_id != self._episode_id:
            raise SourceError(f"{self.path} has no episode {episode_id!r}; it has: {self._episode_id}.")
        return McapEpisode(self.path, episode_id)
