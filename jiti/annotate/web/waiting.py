"""How far each episode is: an annotator's segments, and the proposals that wait for that annotator."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa

from jiti.annotate.folder import annotator_dirs
from jiti.annotate.labels import read_labels
from jiti.annotate.names import MACHINES
from jiti.annotate.partition import Partition
from jiti.annotate.proposals import expected_change, pending, queue
from jiti.annotate.segment_file import to_segments
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
    # Everyone's labels are read, not these alone: what was read of all of them is kept for the next time.
    table = read_labels(labels_dir, skip_newer=True).segments
    table = table.filter(pa.array(np.isin(table["annotator"].to_numpy(), [annotator, *MACHINES])))
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


def waiting(labels_dir: Path, partition: Partition) -> list[Segment]:
    """Proposals of an episode that its annotator has not decided, the most to be gained first. Raises LabelError."""
    table = _proposed(labels_dir, _machines_version(labels_dir))
    here = table.filter(pa.array(table["episode_id"].to_numpy() == partition.episode_id))
    return pending(to_segments(here), [segment.parent_id for segment in partition.segments])


def _machines_version(labels_dir: Path) -> tuple[tuple[str, int, int], ...]:
    """Changes when a machine's labels do, as `labels_version`; what people save does not matter here."""
    folders = [(name, folder.stat()) for name, folder in annotator_dirs(labels_dir) if name in MACHINES]
    return tuple((name, status.st_mtime_ns, status.st_ino) for name, status in folders)


@lru_cache(maxsize=2)
def _proposed(labels_dir: Path, _version: object) -> pa.Table:
    """All proposals, kept until the version changes: every save asks for them, and machines write seldom."""
    table = read_labels(labels_dir, annotators=MACHINES, skip_newer=True).segments
    return table.filter(pa.array(table["status"].to_numpy() == "proposed"))
