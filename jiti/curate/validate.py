"""Labels against their recordings: what `jiti validate-rewards --check` lists and the viewer ranks."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jiti.annotate.labels import Labels, read_labels
from jiti.annotate.segment_file import Recording
from jiti.annotate.web.session import Session
from jiti.curate.checks import find_suspects
from jiti.curate.suspects import Suspect
from jiti.episodes.episode import numbers
from jiti.errors import SourceError

KEPT_POINTS = 64
"""Rows kept of a trajectory: twice what `near_identical` compares."""
STATE_WORDS = ("observation.state", "joint_state", "joint", "state", "eef", "pose", "action")
"""Streams that tell how an episode went, the best first."""
SHOWN = 50
"""Suspects that a terminal lists; `--json` lists all."""


class Trajectories:
    """How each episode went: (rows, size) of its most telling numeric stream, thinned out and kept."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._known: dict[str, np.ndarray] = {}

    def __call__(self, episode_id: str) -> np.ndarray:
        """Raises SourceError when the recording cannot be read or has no numbers."""
        if episode_id not in self._known:
            episode = self._session.reader.open(episode_id)
            named = [s.name for s in episode.streams.values() if s.kind == "numeric"]
            if not named:
                raise SourceError(f"{episode_id} has no numeric stream to compare it by.")
            rank = {name: _rank(name) for name in named}
            _, values = numbers(episode, min(named, key=lambda name: rank[name]))
            rows = np.linspace(0, len(values) - 1, min(KEPT_POINTS, len(values))).astype(int)
            self._known[episode_id] = values[rows].astype(np.float32)
        return self._known[episode_id]


def _rank(name: str) -> int:
    return next((k for k, word in enumerate(STATE_WORDS) if word in name.lower()), len(STATE_WORDS))


def suspects_of(
    session: Session, labels: Labels, *, gamma: float, trajectories: Trajectories | None = None
) -> list[Suspect]:
    """Suspects, the worst first. Lengths are compared with what the source lists, without opening recordings."""
    listed = {ref.episode_id: ref.frame_count for ref in session.refs()}
    recordings = {
        name: replace(about, frame_count=listed[name])
        for name, about in labels.by_episode().items()
        if listed.get(name) is not None
    }
    return find_suspects(labels, recordings=recordings, trajectories=trajectories, gamma=gamma)


@dataclass(frozen=True, slots=True)
class Check:
    """The outcome of a check."""

    title: str
    episodes: int
    labelled: int
    segments: int
    suspects: tuple[Suspect, ...]

    @property
    def errors(self) -> int:
        return sum(s.severity == "error" for s in self.suspects)

    def to_json(self) -> dict[str, Any]:
        return {
            "source": self.title,
            "episodes": self.episodes,
            "labelled": self.labelled,
            "segments": self.segments,
            "errors": self.errors,
            "warnings": len(self.suspects) - self.errors,
            "suspects": [s.to_json() for s in self.suspects],
        }


def check_labels(
    session: Session, *, gamma: float, progress: Callable[[float, str], None] = lambda _share, _what: None
) -> Check:
    """Check every label against the recording as it is now: opens each labelled recording, so it takes its time."""
    labels = read_labels(session.store.labels_dir)
    known = labels.by_episode()
    names = [ref.episode_id for ref in session.refs() if ref.episode_id in known]
    now: dict[str, Recording] = {}
    for number, name in enumerate(names):
        progress(number / len(names), name)
        try:
            episode = session.reader.open(name)
        except SourceError:
            continue  # told by `jiti inspect`; its labels are still checked against each other
        now[name] = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
    suspects = find_suspects(labels, recordings=now, trajectories=Trajectories(session), gamma=gamma)
    accepted = int((labels.segments["status"].to_numpy() == "accepted").sum())
    return Check(session.reader.title, len(session.refs()), len(known), accepted, tuple(suspects))


def print_check(check: Check, *, as_json: bool = False) -> None:
    """One line a suspect on standard output, the worst first, and a last line with the totals; or JSON."""
    if as_json:
        print(json.dumps(check.to_json(), indent=2, ensure_ascii=False))
        return
    from rich.console import Console

    console = Console(highlight=False)
    console.print(
        f"{check.title}: {check.labelled} of {check.episodes} episodes labelled, {check.segments} segments.",
        highlight=False,
    )
    for suspect in check.suspects[:SHOWN]:
        colour = "red" if suspect.severity == "error" else "yellow"
        frame = f"frame {suspect.start_frame}" if suspect.episode_id else ""
        place = ", ".join(filter(None, (suspect.episode_id, frame, suspect.annotator, suspect.itc_id)))
        console.print(f"[{colour}]{suspect.severity:<8}[/] [bold]{suspect.kind.replace('_', ' ')}[/]", end=" ")
        console.print(f"{place}: {suspect.message}. {suspect.remedy}", markup=False, highlight=False, soft_wrap=True)
    if len(check.suspects) > SHOWN:
        console.print(f"... and {len(check.suspects) - SHOWN} more; --json lists all.")
    warnings = len(check.suspects) - check.errors
    console.print(f"{check.errors} errors, {warnings} warnings." if check.suspects else "Nothing looks wrong.")
