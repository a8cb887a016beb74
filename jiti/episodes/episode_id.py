"""Episode ids of recordings in files: safe as file names, and different for different paths."""

import os
from pathlib import Path
from urllib.parse import quote

SUFFIX = ".mcap"


def episode_id_of(path: Path, root: Path) -> str:
    """The path inside `root` without its suffix, percent-encoded as one file name.

    Slashes, percent signs, and a leading dot are encoded too, so that ids are never hidden files and decode to
    exactly one path. Bytes that are not UTF-8 are kept.
    """
    inside = os.fsencode(path.relative_to(root))
    name = quote(inside.removesuffix(SUFFIX.encode()), safe="")
    return "%2E" + name[1:] if name.startswith(".") else name
