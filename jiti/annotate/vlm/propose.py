"""A model's proposals for one episode: its notes, completed by asking what is missing, as segments."""

from collections.abc import Collection
from typing import Literal

from jiti.annotate.events import find_events
from jiti.annotate.measured import MEASURED_CONFIDENCE, decide_by_numbers
from jiti.annotate.readings import Readings
from jiti.annotate.segments import Segment
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import ModelFailed
from jiti.annotate.vlm.calibration import Calibration
from jiti.annotate.vlm.decide import decide
from jiti.annotate.vlm.locate import Overview, locate, overview
from jiti.annotate.vlm.notes import UNDECIDED, Decision, ItcNotes, Notes
from jiti.annotate.vlm.settings import Settings
from jiti.annotate.window import frames_between, proposed_segment, proposed_window
from jiti.episodes.episode import Episode
from jiti.errors import SourceError
from jiti.tasks.task import Task

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
                f"{episode.episode_id} has no camera, so a VLM cannot see it; `jiti autolabel` without --vlm can do."
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
    """Ask what the notes lack, and write it down, failures as well. Raises SourceError for damaged pictures."""
    cameras = cameras_of(episode, settings.cameras)
    instruction = task.instruction or episode.task or ""
    shown: Overview | None = None
    readings = Readings(episode)
    notes.model = asker.model
    for itc in task.itcs:
        known = notes.itcs.setdefault(itc.itc_id, ItcNotes())
        located = settings.locate_key(instruction, itc, cameras)
        if "segments" in stages and not known.has_spans(located):
            shown = shown or overview(episode, cameras, find_events(episode))
            known.located, known.spans, known.located_failure = located, [], ""
            known.decided, known.decisions = "", []
            try:
                known.spans = locate(asker, episode, instruction, itc, shown)
            except ModelFailed as error:
                known.located_failure = str(error)
        decided = settings.decide_key(known.located, itc)
        if "verdicts" not in stages or not known.spans or known.has_decisions(decided):
            continue
        known.decided, known.decisions = decided, []
        measured = decide_by_numbers(episode, itc, readings) if settings.fuse else None
        for span in known.spans:
            if measured is not None:
                decision = Decision(
                    measured.satisfied, MEASURED_CONFIDENCE, measured.reason, by="numbers", frame=measured.frame
                )
            else:
                try:
                    decision = decide(asker, episode, instruction, itc, span, cameras=cameras, samples=settings.samples)
                except ModelFailed as error:
                    decision = Decision(None, None, "", failure=str(error))
            known.decisions.append(decision)


def segments_of(notes: Notes, episode: Episode, task: Task, calibration: Calibration) -> list[Segment]:
    """Proposals from what is written down. A span whose verdict is missing or failed has none and is for people.

    Where numbers decided, there is one segment, which ends where they did, in place of the model's.
    """
    found: list[Segment] = []
    for itc in task.itcs:
        known = notes.itcs.get(itc.itc_id, ItcNotes())
        decisions = known.decisions or [UNDECIDED] * len(known.spans)
        for span, decision in zip(known.spans, decisions, strict=True):
            said = " ".join(filter(None, (decision.rationale, f"Seen: {span.evidence}")))
            verdict = {
                "reward": None if decision.satisfied is None else int(decision.satisfied),
                "rationale": said,
                "confidence": None if decision.confidence is None else calibration.apply(decision.confidence),
            }
            if decision.frame is not None:
                verdict["confidence"] = decision.confidence
                found.append(proposed_window(episode, itc, decision.frame, source="vlm", **verdict))
                break
            start, end = frames_between(episode.clock, span.start_s, span.end_s)
            found.append(proposed_segment(episode, itc, start, end, source="vlm", **verdict))
    return found
