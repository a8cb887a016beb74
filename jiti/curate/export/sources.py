"""What is merged: sources of episodes, each with its labels and tasks."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.web.session import open_session
from jiti.curate.export.counted import Counted, Rule, read_counted
from jiti.episodes.episode import EpisodeReader
from jiti.episodes.mcap_reader import McapReader
from jiti.errors import UsageError
from jiti.tasks.catalogue import Catalogue


@dataclass(frozen=True, slots=True)
class Source:
    """One source."""

    name: str
    """The folder's or file's name, or the Hub id; as given where two have one name."""
    given: str
    """For a command line."""
    reader: EpisodeReader
    labels_dir: Path
    catalogue: Catalogue
    counted: Counted


def open_sources(
    given: Sequence[str], *, labels: Sequence[Path], tasks: Sequence[Path] | None, rule: Rule
) -> list[Source]:
    """Open them and read their labels. Without any, the current folder. Raises JitiError.

    `labels` is empty for the default of each source, one folder for all, or one for each.
    """
    names = list(given) or ["."]
    if len(labels) not in (0, 1, len(names)):
        raise UsageError(
            f"--labels is given {len(labels)} times for {len(names)} sources; give none, one for all, or one for each."
        )
    if twice := [name for name, count in Counter(_resolved(name) for name in names).items() if count > 1]:
        raise UsageError(f"the source {twice[0]} is given twice; each episode must be there once.")
    if gone := [folder for folder in labels if not folder.is_dir()]:
        raise UsageError(f"--labels {gone[0]} is not a folder; there are no labels to take.")
    short = [_short(name) for name in names]
    found = []
    for place, name in enumerate(names):
        session = open_session(
            None if name == "." else name,
            annotator=None,
            labels=labels[place if len(labels) == len(names) else 0] if labels else None,
            tasks=tasks,
        )
        labels_dir = session.store.labels_dir
        # Of one file, only its own labels: the folder that it shares with other recordings holds theirs as well.
        only = [ref.episode_id for ref in session.refs()] if isinstance(session.reader, McapReader) else None
        counted = read_counted(labels_dir, rule, episodes=only)
        shown = short[place] if short.count(short[place]) == 1 else name
        found.append(Source(shown, name, session.reader, labels_dir, session.catalogue, counted))
    return found


def _resolved(name: str) -> str:
    path = Path(name).expanduser()
    return str(path.resolve()) if path.exists() else name


def _short(name: str) -> str:
    path = Path(name).expanduser()
    return path.resolve().name if path.exists() else name
