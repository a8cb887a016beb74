"""A suspect: a place in the labels that looks like a mistake, why it does, and what to do about it."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

Severity = Literal["error", "warning"]

WEIGHTS: dict[str, float] = {
    "unreadable_labels": 1.0,
    "other_recording": 0.95,
    "outside_episode": 0.9,
    "contradiction": 0.85,
    "never_positive": 0.8,
    "disagreement": 0.7,
    "near_identical": 0.6,
    "flip": 0.55,
    "too_short": 0.5,
    "return_outlier": 0.4,
    "unreadable_recording": 0.35,
    "undecided": 0.3,
    "never_negative": 0.2,
}
"""Kinds of suspects, and the highest score of each. Our choice: how sure a mistake is, times how much it spoils."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """One place to look at."""

    kind: str
    """One of `WEIGHTS`."""
    severity: Severity
    """`error` where labels contradict the recording, themselves or each other; `warning` where they are unlikely."""
    score: float
    """0 to 1: the higher, the sooner to look."""
    message: str
    remedy: str
    episode_id: str = ""
    """Empty when it is about a file that names none."""
    annotator: str = ""
    """Two names with ` / ` between them where two differ."""
    itc_id: str = ""
    segment_id: str = ""
    start_frame: int = 0
    """Where to look."""

    def to_json(self) -> dict[str, Any]:
        """All fields by name."""
        return asdict(self)


def suspect(kind: str, severity: Severity, magnitude: Any, message: str, remedy: str, **place: Any) -> Suspect:
    """A suspect whose score is between half of its kind's weight and all of it, by a magnitude in 0 to 1.

    The message has no full stop at its end: an error's own text may be one, and the remedy is said after it.
    """
    score = WEIGHTS[kind] * (0.5 + 0.5 * min(1.0, max(0.0, float(magnitude))))
    return Suspect(kind, severity, round(score, 4), message.rstrip(". "), remedy, **place)


def ranked(suspects: Iterable[Suspect]) -> list[Suspect]:
    """Errors first, then by score, then by place."""
    return sorted(
        suspects,
        key=lambda s: (
            s.severity != "error",
            -s.score,
            s.kind,
            s.episode_id,
            s.itc_id,
            s.start_frame,
            s.annotator,
            s.segment_id,
        ),
    )
