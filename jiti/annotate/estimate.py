"""What `jiti autolabel --vlm` would ask of a model that it has not asked before."""

from contextlib import suppress

from jiti.annotate.measured import decide_by_numbers
from jiti.annotate.proposer import Proposer
from jiti.annotate.readings import Readings
from jiti.annotate.vlm.answers import Span
from jiti.annotate.vlm.cost import Estimate
from jiti.annotate.vlm.notes import ItcNotes, notes_path, read_notes
from jiti.annotate.vlm.prompts import decide_prompt, locate_prompt
from jiti.annotate.vlm.propose import cameras_of
from jiti.annotate.vlm.sampling import OVERVIEW_FRAMES, SEGMENT_FRAMES
from jiti.annotate.vlm.settings import Settings
from jiti.annotate.vlm.sheets import sheet_size
from jiti.episodes.episode import Episode, EpisodeReader
from jiti.errors import JitiError, SourceError
from jiti.progress import Progress
from jiti.tasks.catalogue import Catalogue

FACT_TOKENS = 350
"""A table of 12 rows of numbers."""


def estimate(
    reader: EpisodeReader,
    catalogue: Catalogue,
    proposer: Proposer,
    progress: Progress = lambda _share, _what: None,
) -> Estimate:
    """What the run would ask that it has not asked before; answers in the cache are not looked for."""
    total, refs = Estimate(), reader.episodes()
    settings = proposer.settings or Settings()
    for done, ref in enumerate(refs):
        progress(done / len(refs), ref.title)
        before = total.requests
        try:
            _episode(total, reader.open(ref.episode_id), catalogue, proposer, settings)
        except JitiError:
            total.unreadable += 1
            continue
        total.episodes += 1
        total.done += total.requests == before
    progress(1.0, "done")
    return total


def _episode(total: Estimate, episode: Episode, catalogue: Catalogue, proposer: Proposer, settings: Settings) -> None:
    cameras: tuple[str, ...] = ()
    with suppress(SourceError):  # numbers may decide all of it
        cameras = cameras_of(episode, settings.cameras)
    task = catalogue.for_episode(episode)
    instruction = task.instruction or episode.task or ""
    notes = read_notes(notes_path(proposer.labels_dir, episode.episode_id), episode.fingerprint)
    readings = Readings(episode)
    count = episode.clock.frame_count
    for itc in task.itcs:
        known = notes.itcs.get(itc.itc_id, ItcNotes())
        if "verdicts" in proposer.stages and settings.fuse and decide_by_numbers(episode, itc, readings) is not None:
            total.by_numbers += 1
            continue
        cameras = cameras or cameras_of(episode, settings.cameras)
        located = settings.locate_key(instruction, itc, cameras)
        spans = len(known.spans) if known.has_spans(located) else int("segments" in proposer.stages)
        if "segments" in proposer.stages and not known.has_spans(located):
            views = [(camera, []) for camera in cameras]
            total.add(locate_prompt(instruction, itc, views, ()), _sizes(episode, cameras, min(count, OVERVIEW_FRAMES)))
        elif known.has_decisions(settings.decide_key(instruction, itc, cameras, known.spans)):
            continue
        if "verdicts" in proposer.stages and spans:
            prompt = decide_prompt(
                instruction, itc, Span(0, 1, ""), [(c, []) for c in cameras], "", seed=0, temperature=0
            )
            sizes = _sizes(episode, cameras, min(count, SEGMENT_FRAMES + 2))
            total.add(prompt, sizes, times=spans * settings.samples, facts=FACT_TOKENS)


def _sizes(episode: Episode, cameras: tuple[str, ...], frames: int) -> list[tuple[int, int]]:
    sizes = []
    for camera in cameras:
        height, width = episode.streams[camera].shape[:2] or (480, 640)
        sizes += sheet_size(width, height, frames)
    return sizes
