"""Names that become folder and file names: annotators and episodes."""

import getpass
import re
import unicodedata

from jiti.errors import LabelError

MACHINES = ("signal", "vlm", "sim")
"""Annotators whose rows are proposals."""

ADJUDICATED = "adjudicated"
"""The annotator of rows that settle what annotators disagreed on."""

_MAX_BYTES = 200
"""Of 255 that file systems take: the rest is for our suffixes and temporary names."""

_NOT_ALLOWED = re.compile(r"[^\w.@+-]")


def check_name(name: str) -> str:
    """The name in Unicode's composed form, if it can name a partition of labels. Raises LabelError.

    It starts with a letter, because dataset readers skip `.` and `_` and take `annotator=7` for a number.
    """
    name = unicodedata.normalize("NFC", name)
    if not name:
        raise LabelError("an annotator's name is empty. Pass --annotator NAME.")
    if wrong := _NOT_ALLOWED.search(name):
        raise LabelError(
            f"the annotator name {name!r} has {wrong.group()!r} in it; names are folder names and take letters, digits "
            f"and . _ - @ +. Pass --annotator {_made_safe(name)}."
        )
    if not name[0].isalpha():
        raise LabelError(
            f"the annotator name {name!r} starts with {name[0]!r}; it must start with a letter. "
            f"Pass --annotator {_made_safe(name)}."
        )
    if len(name.encode()) > _MAX_BYTES:
        raise LabelError(f"the annotator name {name[:40]!r}... is longer than {_MAX_BYTES} bytes. Pass a shorter one.")
    return name


def check_annotator(name: str) -> str:
    """As `check_name`, for a person: the names of machines and of settled differences are not theirs to use."""
    name = check_name(name)
    if name.lower() in (*MACHINES, ADJUDICATED):
        purpose = "settled differences" if name.lower() == ADJUDICATED else "proposals"
        raise LabelError(f"the annotator name {name!r} is kept for {purpose}. Pass --annotator with your own name.")
    return name


def default_annotator() -> str:
    """The login name, made safe; `annotator` where the machine knows none."""
    try:
        login = getpass.getuser()
    except (KeyError, OSError):  # a container whose user id has no name
        return "annotator"
    return _made_safe(login.rpartition("\\")[2])


def file_stem(episode_id: str) -> str:
    """The file name of an episode's labels, without its ending. Raises LabelError for an id that cannot be one.

    Dataset readers skip files that start with `_`, so that one is percent-encoded.
    """
    if not episode_id or "/" in episode_id or "\0" in episode_id or episode_id.startswith((".", "%5F")):
        raise LabelError(
            f"the episode id {episode_id!r} cannot be a file name; it must not be empty, contain '/' or start with '.'"
        )
    stem = f"%5F{episode_id[1:]}" if episode_id.startswith("_") else episode_id
    if len(stem.encode()) > _MAX_BYTES:
        raise LabelError(
            f"the episode id {episode_id[:40]!r}... is longer than {_MAX_BYTES} bytes; shorten the recording's name"
        )
    return stem


def _made_safe(name: str) -> str:
    safe = _NOT_ALLOWED.sub("-", unicodedata.normalize("NFC", name)).lstrip("._-@+")[:60]
    if not safe or not safe[0].isalpha():
        safe = f"annotator-{safe}".rstrip("-")
    return f"{safe}-2" if safe.lower() in (*MACHINES, ADJUDICATED) else safe
