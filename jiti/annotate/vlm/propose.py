"""A model's proposals for one episode: its notes, completed by asking what is missing, as segments."""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Literal

from jiti.annotate.events import find_events
from jiti.annotate.measured import MEASURED_CONFIDENCE, decide_by_numbers
from jiti.annotate.readings import Readings
from jiti.annotate.segments import Segment
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import ModelFailed
from jiti.annotate.vlm.calibration import Calibration
from jiti.annotate.vlm.decide import decide
from jiti.annotate.vlm.locate import locate, overview
from jiti.annotate.vlm.notes import UNDECIDED, Decision, ItcNotes, Notes
from jiti.annotate.vlm.settings import Settings
from jiti.annotate.window import frames_between, proposed_segment, proposed_window
from jiti.episodes.episode import Episode
from jiti.errors import CatalogueError, SourceError
from jiti.tasks.task import ITC, Task

ANNOTATOR = "vlm"
"""Name of the partition that these proposals are written to."""
Stage = Literal["segments", "verdicts"]


def cameras_of(episode: Episode, wanted: tuple[str, ...]) -> tuple[str, ...]:
    """Streams to show: those that were named, in full or by the end of their names, else all colour cameras.

    Raises SourceError when there is none.
    """
    known = [s.name for s in episode.streams.values() if s.kind == "camera"]
    if not wanted:
        if not known:
            raise SourceError(
                f"{episode.episode_id} has no camera, so a VLM cannot see it; `jiti autolabel` without --vlm can do"
            )
        return tuple(known)
    found = []
    for name in wanted:
        fitting = [k for k in known if k == name or k.rpartition("/")[2] == name or k.rpartition(".")[2] == name]
        if len(fitting) != 1:
            raise SourceError(
                f"{episode.episode_id} has no camera {name!r}; it has: {', '.join(known) or 'none'}. Pass --camera."
            )
        found.append(fitting[0])
    return tuple(found)


def complete(
    notes: Notes, episode: Episode, task: Task, asker: Asker, settings: Settings, stages: Collection[Stage]
) -> None:
    """Ask what the notes lack, and write it down. A try without an answer is written down beside what was there.

    Raises SourceError for damaged pictures, or where there is none and something is left to ask.
    """
    instruction = task.instruction or episode.task or ""
    readings, shown = Readings(episode), None
    for itc in task.itcs:
        known = notes.itcs.setdefault(itc.itc_id, ItcNotes())
        if "verdicts" in stages:
            known.measured = _measured(episode, itc, readings) if settings.fuse else None
        if known.measured is not None and settings.fuse:
            continue
        cameras = cameras_of(episode, settings.cameras)
        located = settings.locate_key(instruction, itc, cameras)
        if "segments" in stages and not known.has_spans(located):
            shown = shown or overview(episode, cameras, find_events(episode))
            try:
                spans = locate(asker, episode, instruction, itc, shown)
            except ModelFailed as error:
                known.located_failure = str(error)
                continue
            if spans != known.spans:
                known.decided, known.decisions = "", []
            known.located, known.spans, known.located_failure = located, spans, ""
        decided = settings.decide_key(instruction, itc, cameras, known.spans)
        if "verdicts" in stages and known.spans and not known.has_decisions(decided):
            known.decided, known.decisions = (
                decided,
                _decide_all(known, episode, instruction, itc, asker, settings, cameras),
            )


def segments_of(notes: Notes, episode: Episode, task: Task, calibration: Callable[[str], Calibration]) -> list[Segment]:
    """Proposals from what is written down. A span whose verdict is missing or failed has none and is for people.

    Where numbers decided, there is one segment, which ends where they did. `calibration` is that of a model.
    """
    found: list[Segment] = []
    for itc in task.itcs:
        known = notes.itcs.get(itc.itc_id, ItcNotes())
        if (by := known.measured) is not None and by.frame is not None:
            verdict = {"reward": int(bool(by.satisfied)), "rationale": by.rationale, "confidence": by.confidence}
            found.append(proposed_window(episode, itc, by.frame, source="vlm", **verdict))
            continue
        decisions = known.decisions or [UNDECIDED] * len(known.spans)
        for span, by in zip(known.spans, decisions, strict=True):
            start, end = frames_between(episode.clock, span.start_s, span.end_s)
            verdict = {
                "reward": None if by.satisfied is None else int(by.satisfied),
                "rationale": " ".join(filter(None, (by.rationale, f"Seen: {span.evidence}"))),
                "confidence": None if by.confidence is None else calibration(by.model).apply(by.confidence),
            }
            found.append(proposed_segment(episode, itc, start, end, source="vlm", **verdict))
    return found


def _measured(episode: Episode, itc: ITC, readings: Readings) -> Decision | None:
    """What recorded poses decide; a goal that cannot be read is left to the model."""
    try:
        found = decide_by_numbers(episode, itc, readings)
    except CatalogueError:
        return None
    return found and Decision(found.satisfied, MEASURED_CONFIDENCE, found.reason, by="numbers", frame=found.frame)


def _decide_all(
    known: ItcNotes,
    episode: Episode,
    instruction: str,
    itc: ITC,
    asker: Asker,
    settings: Settings,
    cameras: tuple[str, ...],
) -> list[Decision]:
    """A decision a span; where there is no answer now, the one that was there, with the reason."""
    before = known.decisions or [UNDECIDED] * len(known.spans)
    decisions = []
    for span, old in zip(known.spans, before, strict=True):
        try:
            decisions.append(decide(asker, episode, instruction, itc, span, cameras=cameras, samples=settings.samples))
        except ModelFailed as error:
            decisions.append(replace(old, failure=str(error)))
    return decisions
