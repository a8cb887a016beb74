"""How far each episode is: an annotator's segments, and the proposals that wait for that annotator."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.labels import read_labels
from jiti.annotate.names import MACHINES
from jiti.annotate.proposals import expected_change, queue
from jiti.annotate.segments import Segment


@dataclass(slots=True)
class Progress:
    """Of one annotator on one episode."""

    segments: int = 0
    undecided: int = 0
    proposals: int = 0
    expected_change: float = 0.0
    """Frames whose label a review of the proposals is expected to change."""


def progress(labels_dir: Path, annotator: str) -> Mapping[str, Progress]:
    """By episode id; episodes that nobody touched are not in it but count as untouched. Raises LabelError."""
    table = read_labels(labels_dir, annotators=[annotator, *MACHINES]).segments
    found: dict[str, Progress] = defaultdict(Progress)
    own = zip(*(table[name].to_pylist() for name in ("annotator", "episode_id", "status", "reward")), strict=True)
    for name, episode_id, status, reward in own:
        if name == annotator and status == "accepted":
            found[episode_id].segments += 1
            found[episode_id].undecided += reward is None
    for proposal in queue(table, annotator):
        found[proposal.episode_id].proposals += 1
        found[proposal.episode_id].expected_change += expected_change(proposal)
    return found


def waiting(labels_dir: Path, annotator: str, episode_id: str) -> list[Segment]:
    """Proposals of one episode that the annotator has not decided, the most to be gained first."""
    table = read_labels(labels_dir, annotators=[annotator, *MACHINES], episodes=[episode_id]).segments
    return queue(table, annotator)
