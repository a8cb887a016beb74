"""What a model said about an episode: one JSON file, from which a run goes on and the proposals are made."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from jiti.annotate.names import file_stem
from jiti.annotate.vlm.answers import Span
from jiti.durable import make_folder, write_atomic


@dataclass(frozen=True, slots=True)
class Decision:
    """The verdict on one span."""

    satisfied: bool | None
    """None where it failed; then `failure` says why."""
    confidence: float | None
    rationale: str
    by: str = "vlm"
    """`vlm`, or `numbers` where recorded poses decided."""
    frame: int | None = None
    """Where numbers decided it; None where the span stands as the model gave it."""
    samples: int = 0
    model: str = ""
    """That gave it."""
    failure: str = ""
    """Why the last try had no answer; what stands beside it is from an earlier one."""


UNDECIDED = Decision(None, None, "")
"""Of a span that no verdict was asked for yet."""


@dataclass
class ItcNotes:
    """One ITC of an episode, through both stages."""

    located: str = ""
    """What stage two was asked with (`Settings.locate_key`); empty before it."""
    spans: list[Span] = field(default_factory=list)
    located_failure: str = ""
    """Why the last try had no answer; the spans are then from an earlier one."""
    decided: str = ""
    """What stage three was asked with (`Settings.decide_key`); empty before it."""
    decisions: list[Decision] = field(default_factory=list)
    """One a span."""
    measured: Decision | None = None
    """Where numbers decided it; then the model was not asked."""

    @property
    def failures(self) -> list[str]:
        found = [f"segments: {self.located_failure}"] if self.located_failure else []
        return found + [f"verdict: {d.failure}" for d in self.decisions if d.failure]

    def has_spans(self, key: str) -> bool:
        """Whether stage two has been done as it would be now."""
        return self.located == key and not self.located_failure

    def has_decisions(self, key: str) -> bool:
        """Whether stage three has."""
        return self.decided == key and not any(d.failure for d in self.decisions)


@dataclass
class Notes:
    """One episode."""

    fingerprint: str
    itcs: dict[str, ItcNotes] = field(default_factory=dict)


def notes_path(labels_dir: Path, episode_id: str) -> Path:
    """Where the notes on an episode are."""
    return labels_dir / "vlm" / "notes" / f"{file_stem(episode_id)}.json"


def read_notes(path: Path, fingerprint: str) -> Notes:
    """Empty ones for a recording that has changed, or a file that cannot be read: the model is asked again."""
    try:
        row = json.loads(path.read_bytes())
        notes = Notes(row["fingerprint"], {name: _itc(itc) for name, itc in row["itcs"].items()})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Notes(fingerprint)
    return notes if notes.fingerprint == fingerprint else Notes(fingerprint)


def write_notes(path: Path, notes: Notes) -> None:
    """Raises SaveFailed."""
    make_folder(path.parent)
    write_atomic(path, json.dumps(asdict(notes), indent=1).encode())


def _itc(row: dict[str, Any]) -> ItcNotes:
    spans = [Span(**span) for span in row["spans"]]
    decisions = [Decision(**decision) for decision in row["decisions"]]
    measured = row["measured"] and Decision(**row["measured"])
    return ItcNotes(row["located"], spans, row["located_failure"], row["decided"], decisions, measured or None)
