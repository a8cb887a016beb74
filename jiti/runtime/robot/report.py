"""What an arm's episodes were like: how well the loop kept its rate, how often it waited, and what each part took."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jiti.runtime.robot.recording import Recording
from jiti.runtime.robot.turn import Turn

PARTS = (("observe_s", "reading arm and cameras"), ("send_s", "sending"), ("busy_s", "a step, without its wait"))
DECISION_PARTS = (
    ("sample_s", "policy"),
    ("score_s", "critic"),
    ("round_trip_s", "a decision, with its way there and back"),
)


@dataclass(frozen=True, slots=True)
class Latency:
    """Milliseconds of what was measured several times."""

    p50: float
    p99: float
    most: float


@dataclass(frozen=True, slots=True)
class EpisodeSummary:
    """One episode of an arm."""

    number: int
    guidance: str
    """As in simulation: `none`, `jiti`."""
    recording: str | None
    ended: str
    """`time`, `Enter`, or what stopped it."""
    seconds: float
    steps: int
    """Of the loop, those before the first decision included."""
    acting: int
    """Steps since then."""
    held: int
    """Of these, those at which there was nothing to execute."""
    unread: int
    """Of all, those at which the arm could not be read."""
    clamped: int
    """Steps at which a joint was asked for more than it may."""
    decisions: int
    triggered: int
    """Decisions at which candidates were looked at."""
    changed: int
    """Decisions at which another chunk than the default was taken."""
    dropped: float
    """Actions of a chunk that were over when it arrived, on the mean."""
    period_ms: Latency
    parts_ms: dict[str, Latency]


def summarize(recording: Recording, turn: Turn, ended: str) -> EpisodeSummary:
    """Of what a recording was told."""
    ticks, decisions = recording.ticks, recording.decisions
    acting = [tick for tick in ticks if tick["begun"]]
    seconds = (ticks[-1]["time_ns"] - ticks[0]["time_ns"]) / 1e9 if ticks else 0.0
    parts = {name: _latency(ticks, name) for name, _ in PARTS}
    parts |= {name: _latency(decisions, name) for name, _ in DECISION_PARTS}
    return EpisodeSummary(
        turn.number,
        turn.label,
        str(recording.path) if recording.path else None,
        ended,
        seconds,
        len(ticks),
        len(acting),
        sum(tick["held"] for tick in acting),
        sum(not tick["read"] for tick in ticks),
        sum(bool(tick["clamped"]) for tick in ticks),
        len(decisions),
        sum(d["triggered"] for d in decisions),
        sum(d["chosen"] != 0 for d in decisions),
        float(np.mean([d["dropped"] for d in decisions])) if decisions else float("nan"),
        _latency(ticks, "period_s"),
        parts,
    )


def _latency(rows: Iterable[dict[str, Any]], name: str) -> Latency:
    known = [1000 * row[name] for row in rows if row[name] is not None]
    if not known:
        return Latency(float("nan"), float("nan"), float("nan"))
    return Latency(*(float(value) for value in np.percentile(known, [50, 99, 100])))


@dataclass(frozen=True)
class RobotReport:
    """What a run of `jiti rollout --robot` has to say."""

    task: str
    robot: str
    taken: dict[str, Any]
    episodes: Sequence[EpisodeSummary]
    misread: int
    """Exchanges with the servos that had to be tried again."""
    overloads: dict[str, int]
    """By joint: looks at it at which it said so."""
    folder: Path

    def to_dict(self) -> dict[str, Any]:
        return {
            "task": self.task,
            "robot": self.robot,
            **self.taken,
            "folder": str(self.folder),
            "misread": self.misread,
            "overloads": self.overloads,
            "episodes": [asdict(episode) for episode in self.episodes],
        }

    def print(self) -> None:
        """Lines on standard output."""
        print(f"{self.task} on {self.robot}")
        for e in self.episodes:
            share = e.held / e.acting if e.acting else 0.0
            print(f"episode {e.number}, {e.guidance}: {e.seconds:.1f} s, {e.steps} steps; ended: {e.ended}")
            print(
                f"  period {_told(e.period_ms)}; held at {e.held} of {e.acting} steps ({share:.1%}), unread {e.unread}"
            )
            print(
                f"  {e.decisions} decisions, {e.triggered} looked at candidates, {e.changed} took another chunk; "
                f"{e.dropped:.1f} actions over on arrival; {e.clamped} steps clamped"
            )
            for name, what in (*PARTS, *DECISION_PARTS):
                print(f"  {what}: {_told(e.parts_ms[name])}")
            if e.recording:
                print(f"  {e.recording}")
        if self.misread:
            print(f"{self.misread} exchanges with the servos had to be tried again")
        for joint, looks in self.overloads.items():
            if looks:
                print(f"{joint} said at {looks} looks that it is overloaded: let it press less")


def _told(latency: Latency) -> str:
    return f"{latency.p50:.1f} ms (p99 {latency.p99:.1f}, most {latency.most:.1f})"
