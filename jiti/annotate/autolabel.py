"""`jiti autolabel`: what a machine proposes for every episode of a source, for people to decide."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jiti.annotate import signals, simulator
from jiti.annotate.proposals import write_proposals
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment
from jiti.episodes.episode import Episode, EpisodeReader
from jiti.errors import CatalogueError, LabelError, SourceError, UsageError
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

ProposalSource = Literal["sim", "signal"]
"""What proposes: the predicates that a simulator traced, or the recording's own numbers."""

_PROPOSE: dict[ProposalSource, tuple[str, Callable[[Episode, Task], list[Segment]]]] = {
    "sim": (simulator.ANNOTATOR, simulator.propose_from_simulator),
    "signal": (signals.ANNOTATOR, signals.propose_segments),
}


@dataclass(frozen=True, slots=True)
class Autolabelled:
    """What was written. Its text is for a person."""

    labels_dir: Path
    source: ProposalSource
    episodes: int
    proposals: int
    """That are there now, those that people decided included."""
    satisfied: int
    violated: int
    """Verdicts of this run; the rest was left open."""
    skipped: tuple[str, ...]
    """Episodes without proposals, each with the reason."""

    def __str__(self) -> str:
        verdicts = f", {self.satisfied} satisfied and {self.violated} violated" if self.source == "sim" else ""
        lines = [f"{self.proposals} proposals from {self.source} for {self.episodes} episodes{verdicts}."]
        lines += [f"left out: {reason}" for reason in self.skipped]
        return "\n".join([*lines, f"They are in {self.labels_dir}; `jiti annotate` shows them for review."])

    def to_json(self) -> str:
        """For `--json`."""
        told = {field: getattr(self, field) for field in self.__dataclass_fields__}
        return json.dumps(told | {"labels_dir": str(self.labels_dir)}, indent=2)


def autolabel(
    reader: EpisodeReader,
    catalogue: Catalogue,
    labels_dir: Path,
    *,
    source: ProposalSource,
    progress: Callable[[float, str], None] = lambda _share, _what: None,
) -> Autolabelled:
    """Propose segments for every episode, replacing what this machine proposed before and no one decided.

    What people did stays. An episode that cannot be read, or has no trace, is left out and said; a stopped run can be
    run again. Raises UsageError when nothing at all could be proposed for, SaveFailed when the disk refuses.
    """
    annotator, propose = _PROPOSE[source]
    refs = reader.episodes()
    skipped: list[str] = []
    episodes = proposals = 0
    verdicts: list[int | None] = []
    for done, ref in enumerate(refs):
        progress(done / len(refs), f"proposing for {ref.title}")
        try:
            episode = reader.open(ref.episode_id)
            found = propose(episode, catalogue.for_episode(episode))
        except (SourceError, LabelError, CatalogueError) as error:
            skipped.append(f"{ref.title}: {error}")
            continue
        recording = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
        proposals += write_proposals(labels_dir, annotator, episode.episode_id, found, recording)
        verdicts += [segment.reward for segment in found]
        episodes += 1
    progress(1.0, "done")
    if not episodes:
        reasons = "; ".join(skipped[:3]) or "there is no episode"
        raise UsageError(f"nothing was proposed for {reader.title}: {reasons}")
    return Autolabelled(labels_dir, source, episodes, proposals, verdicts.count(1), verdicts.count(0), tuple(skipped))


def best_source(reader: EpisodeReader) -> ProposalSource:
    """What can propose for a source: its first episode that can be opened says whether a simulator recorded it."""
    for ref in reader.episodes():
        try:
            return "sim" if simulator.has_trace(reader.open(ref.episode_id)) else "signal"
        except SourceError:
            continue
    return "signal"
