"""The labels of a source that count: by which rule, whose, and machines' proposals where they are accepted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from jiti.annotate.labels import Labels, read_labels
from jiti.annotate.names import MACHINES
from jiti.annotate.segment_file import Recording, to_segments
from jiti.annotate.segments import Segment
from jiti.curate.verdicts import replaced
from jiti.errors import LabelError, UsageError

MAJORITY = "majority"
"""All annotators, as `jiti.curate.verdicts.RULE` says."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Whose labels count."""

    name: str = MAJORITY
    """`majority`, `adjudicated`, or an annotator."""
    accept: tuple[str, ...] = ()
    """Machines whose proposals count although no one has accepted them."""

    def __post_init__(self) -> None:
        if wrong := [name for name in self.accept if name not in MACHINES]:
            raise UsageError(f"--accept {wrong[0]} is no machine; machines that propose are {', '.join(MACHINES)}.")

    def __str__(self) -> str:
        proposals = f", and proposals of {', '.join(self.accept)} that no one has settled" if self.accept else ""
        return f"{self.name}{proposals}"


@dataclass(frozen=True, slots=True)
class Counted:
    """What counts of one labels folder."""

    segments: Mapping[str, Sequence[tuple[str, Segment]]]
    """Annotator and segment, by episode id; by start, then annotator and id."""
    recordings: Mapping[str, Recording]
    """What was labelled, by episode id."""
    annotators: tuple[str, ...]
    """Everyone who has labels there, counted or not."""


def read_counted(labels_dir: Path, rule: Rule, *, episodes: Sequence[str] | None = None) -> Counted:
    """Read and choose. Raises LabelError for files that cannot be read or annotators that are not there."""
    labels = read_labels(labels_dir, episodes=episodes).whole()
    table = labels.segments
    annotators = tuple(dict.fromkeys(labels.recordings["annotator"].to_pylist()))
    wanted = () if rule.name == MAJORITY else (rule.name,)
    if annotators and (missing := [name for name in (*wanted, *rule.accept) if name not in annotators]):
        flag = "--accept" if missing[0] in rule.accept else "--rule"
        raise LabelError(
            f"{labels_dir} has no labels of {missing[0]!r}, whom {flag} names; there are labels of: "
            f"{', '.join(annotators)}."
        )
    return Counted(_by_episode(table, rule), _agreed(labels, labels_dir), annotators)


def counts(table: pa.Table, rule: Rule) -> np.ndarray:
    """(rows,) bool: whether each row of a table of `read_segments` counts."""
    if not len(table):
        return np.zeros(0, bool)
    annotator, status = table["annotator"].to_numpy(), table["status"].to_numpy()
    decided = table["reward"].fill_null(-1).to_numpy() >= 0
    accepted = status == "accepted"
    if rule.name == MAJORITY:
        accepted &= ~replaced(table)
    else:  # what one annotator said stays theirs, also where the agreement view settled otherwise
        accepted &= annotator == rule.name
    people = ~np.isin(annotator, MACHINES) & np.isin(status, ("accepted", "rejected"))
    settled = {name for name in table["parent_id"].filter(pa.array(people)).to_pylist() if name is not None}
    proposed = np.isin(annotator, rule.accept) & (status == "proposed")
    if settled:
        proposed &= ~np.isin(table["segment_id"].to_numpy(), [*settled])
    return (accepted | proposed) & decided


def _by_episode(table: pa.Table, rule: Rule) -> dict[str, list[tuple[str, Segment]]]:
    chosen = table.filter(pa.array(counts(table, rule)))
    found: dict[str, list[tuple[str, Segment]]] = {}
    for annotator, segment in zip(chosen["annotator"].to_pylist(), to_segments(chosen), strict=True):
        found.setdefault(segment.episode_id, []).append((annotator, segment))
    for rows in found.values():
        rows.sort(key=lambda row: (row[1].start_frame, row[0], row[1].segment_id))
    return found


def _agreed(labels: Labels, labels_dir: Path) -> dict[str, Recording]:
    """Raises LabelError where annotators labelled different recordings under one name."""
    found: dict[str, tuple[str, Recording]] = {}
    columns = ("annotator", "episode_id", "frame_count", "frame_rate_hz", "fingerprint")
    for annotator, episode_id, *about in zip(*(labels.recordings[c].to_pylist() for c in columns), strict=True):
        recording = Recording(*about)
        other, first = found.setdefault(episode_id, (annotator, recording))
        if first.fingerprint != recording.fingerprint:
            raise LabelError(
                f"{labels_dir}: {annotator} and {other} labelled different recordings under the name {episode_id!r}. "
                "Look which one is here with `jiti validate-rewards --check`, and correct or remove the other's labels."
            )
    return {episode_id: recording for episode_id, (_, recording) in found.items()}
