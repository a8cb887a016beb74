"""`jiti autolabel`: what a machine proposes for every episode of a source, for people to decide."""

import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from jiti.annotate import simulator
from jiti.annotate.engine import Engine, WorkerLost, run
from jiti.annotate.proposals import write_proposals
from jiti.annotate.proposer import ANNOTATORS, ProposalSource, Proposer
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment
from jiti.annotate.vlm.backend import NOTHING, Usage
from jiti.annotate.vlm.notes import notes_path, write_notes
from jiti.episodes.episode import EpisodeReader
from jiti.errors import LabelError, SaveFailed, SourceError, UsageError
from jiti.progress import Progress


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
    failures: tuple[str, ...] = ()
    """What a model could not answer, in episodes that have proposals all the same. The next run asks again."""
    usage: Usage = NOTHING
    cost: float | None = None
    """In the currency of the prices that were given."""

    def __str__(self) -> str:
        decided = self.satisfied + self.violated
        verdicts = f", {self.satisfied} satisfied and {self.violated} violated" if decided else ""
        lines = [f"{self.proposals} proposals from {self.source} for {self.episodes} episodes{verdicts}."]
        if self.usage.requests or self.usage.cached:
            spent = self.usage
            price = f", cost {self.cost:.2g}" if self.cost is not None else ""
            lines.append(
                f"{spent.requests} requests, {spent.cached} answers known before; {spent.prompt_tokens} tokens read, "
                f"{spent.completion_tokens} written{price}."
            )
        for title, reasons in (("left out", self.skipped), ("no answer", self.failures)):
            lines += [f"{title}: {reason}" for reason in reasons[:20]]
            if len(reasons) > 20:
                lines.append(f"{title}: {len(reasons) - 20} more; --json lists all")
        if self.failures:
            lines.append("The same command asks the model again for these, and for nothing else.")
        return "\n".join([*lines, f"They are in {self.labels_dir}; `jiti annotate` shows them for review."])

    def to_json(self) -> str:
        """For `--json`."""
        told = {field: getattr(self, field) for field in self.__dataclass_fields__}
        usage = {field: getattr(self.usage, field) for field in self.usage.__dataclass_fields__}
        return json.dumps(told | {"labels_dir": str(self.labels_dir), "usage": usage}, indent=2)


def autolabel(
    reader: EpisodeReader,
    proposer: Proposer,
    *,
    engine: Engine = "local",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress = lambda _share, _what: None,
) -> Autolabelled:
    """Propose segments for every episode, replacing what this machine proposed before and no one decided.

    What people did stays. An episode that cannot be read, or has no trace, is left out and said; a stopped run can be
    run again, and asks a model only what it has not answered. Everything is written here and not by the workers, so
    what is there does not depend on which of them did it. Raises UsageError when nothing at all could be proposed for,
    SaveFailed when the disk refuses.
    """
    refs = reader.episodes()
    titles = {ref.episode_id: ref.title for ref in refs}
    total = Autolabelled(proposer.labels_dir, proposer.by, 0, 0, 0, 0, ())
    skipped: dict[str, str] = {}
    failures: dict[str, Sequence[str]] = {}
    progress(0.0, f"proposing for {len(refs)} episodes")
    with closing(run(proposer, list(titles), engine=engine, workers=workers, address=address)) as results:
        for done, (episode_id, result) in enumerate(results, 1):
            progress(done / len(refs), titles[episode_id])
            if isinstance(result, WorkerLost):
                skipped[episode_id] = str(result)
                continue
            total = replace(total, usage=total.usage + result.usage)
            if result.notes is not None:
                write_notes(notes_path(proposer.labels_dir, episode_id), result.notes)
            if result.recording is None:
                skipped[episode_id] = "; ".join(result.failures)
                continue
            if result.failures:
                failures[episode_id] = result.failures
            try:
                total = _written(total, proposer, episode_id, result.segments, result.recording)
            except SaveFailed:
                raise
            except LabelError as error:
                skipped[episode_id] = str(error)
    progress(1.0, "done")
    # In the order of the source, whatever the order in which they were done.
    left_out = tuple(f"{title}: {skipped[key]}" for key, title in titles.items() if key in skipped)
    if not total.episodes:
        reasons = "; ".join(left_out[:3]) or "there is no episode"
        raise UsageError(f"nothing was proposed for {reader.title}: {reasons}")
    unanswered = tuple(f"{title}: {why}" for key, title in titles.items() for why in failures.get(key, ()))
    return replace(total, skipped=left_out, failures=unanswered)


def best_source(reader: EpisodeReader) -> ProposalSource:
    """What can propose for a source: its first episode that can be opened says whether a simulator recorded it."""
    for ref in reader.episodes():
        try:
            return "sim" if simulator.has_trace(reader.open(ref.episode_id)) else "signal"
        except SourceError:
            continue
    return "signal"


def _written(
    total: Autolabelled, proposer: Proposer, episode_id: str, segments: Sequence[Segment], recording: Recording
) -> Autolabelled:
    """Write one episode's proposals, and count them."""
    count = write_proposals(proposer.labels_dir, ANNOTATORS[proposer.by], episode_id, segments, recording)
    verdicts = [segment.reward for segment in segments]
    return replace(
        total,
        episodes=total.episodes + 1,
        proposals=total.proposals + count,
        satisfied=total.satisfied + verdicts.count(1),
        violated=total.violated + verdicts.count(0),
    )
