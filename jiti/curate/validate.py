"""Labels against their recordings: what `jiti validate-rewards --check` lists and the viewer ranks."""

import gc
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jiti.annotate.labels import Labels, read_labels
from jiti.annotate.segment_file import Recording
from jiti.annotate.web.session import Session
from jiti.curate.checks import find_suspects
from jiti.curate.suspects import Suspect, ranked, suspect
from jiti.episodes.episode import numbers
from jiti.episodes.mcap_reader import McapReader
from jiti.errors import SourceError
from jiti.progress import Progress

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
            # Arrow's metadata of a Parquet file is in a cycle: megabytes an episode, which Python would keep for long.
            gc.collect(1)
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


def check_labels(session: Session, *, gamma: float, progress: Progress = lambda _share, _what: None) -> Check:
    """Check every label against the recording as it is now: opens each labelled recording, so it takes its time.

    A labelled recording that is gone or cannot be opened is an error. Of one file, only its own labels are checked,
    because the folder that it shares with other recordings holds theirs as well. Raises NewerSchema.
    """
    listed = [ref.episode_id for ref in session.refs()]
    only = listed if isinstance(session.reader, McapReader) else None
    labels = read_labels(session.store.labels_dir, episodes=only)
    known = labels.by_episode()
    names = [name for name in listed if name in known]
    now: dict[str, Recording] = {}
    lost = dict.fromkeys(known.keys() - set(listed), f"there is no such recording in {session.reader.title}")
    for number, name in enumerate(names):
        progress(number / len(names), name)
        try:
            episode = session.reader.open(name)
        except SourceError as error:
            lost[name] = f"it cannot be opened: {error}"
            continue
        now[name] = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
    found = find_suspects(labels, recordings=now, trajectories=Trajectories(session), gamma=gamma)
    found = [one for one in found if one.kind != "unreadable_recording" or one.episode_id not in lost]
    suspects = ranked([*found, *_lost_recordings(labels, lost, session.store.labels_dir)])
    accepted = int((labels.segments["status"].to_numpy() == "accepted").sum())
    return Check(session.reader.title, len(listed), len(names), accepted, tuple(suspects))


def _lost_recordings(labels: Labels, lost: Mapping[str, str], labels_dir: Path) -> Iterator[Suspect]:
    """One for each labelled recording that is not there or does not open; `lost` says why, by episode id."""
    names: dict[str, set[str]] = {}
    for episode_id, annotator in zip(
        *(labels.recordings[c].to_pylist() for c in ("episode_id", "annotator")), strict=True
    ):
        names.setdefault(episode_id, set()).add(annotator)
    for episode_id, why in lost.items():
        remedy = f"Restore the recording, or remove its labels in {labels_dir}."
        annotator = " / ".join(sorted(names[episode_id]))
        yield suspect("unreadable_recording", "error", 1, why, remedy, episode_id=episode_id, annotator=annotator)


def print_check(check: Check, *, as_json: bool = False) -> None:
    """One line a suspect on standard output, the worst first, and a last line with the totals; or JSON."""
    if as_json:
        print(json.dumps(check.to_json(), indent=2, ensure_ascii=False))
        return
    from rich.console import Console

    console = Console(highlight=False)
    console.print(
        f"{check.title}: {check.labelled} of {check.episodes} episodes labelled, {check.segments} segments.",
        markup=False,
        soft_wrap=True,
    )
    for one in check.suspects[:SHOWN]:
        colour = "red" if one.severity == "error" else "yellow"
        frame = f"frame {one.start_frame}" if one.episode_id else ""
        place = ", ".join(filter(None, (one.episode_id, frame, one.annotator, one.itc_id)))
        console.print(f"[{colour}]{one.severity:<8}[/] [bold]{one.kind.replace('_', ' ')}[/]", end=" ")
        what = ": ".join(filter(None, (place, one.message)))
        console.print(f"{what}. {one.remedy}", markup=False, soft_wrap=True)
    if len(check.suspects) > SHOWN:
        console.print(f"... and {len(check.suspects) - SHOWN} more; --json lists all.")
    warnings = len(check.suspects) - check.errors
    console.print(f"{check.errors} errors, {warnings} warnings." if check.suspects else "Nothing looks wrong.")
