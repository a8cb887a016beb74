"""What is proposed for one episode, and by whom: picklable, so that it can be done in any process."""

import logging
import threading
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

from jiti.annotate import signals, simulator
from jiti.annotate.measured import decide_by_numbers
from jiti.annotate.readings import Readings
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment
from jiti.annotate.vlm import propose as vlm
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import NOTHING, Usage
from jiti.annotate.vlm.cache import AnswerCache
from jiti.annotate.vlm.calibration import read_calibration
from jiti.annotate.vlm.notes import Notes, notes_path, read_notes
from jiti.annotate.vlm.settings import Settings
from jiti.episodes.episode import Episode, EpisodeReader
from jiti.episodes.reader import open_reader
from jiti.errors import CatalogueError, JitiError, SaveFailed, SourceError, UsageError
from jiti.tasks.catalogue import Catalogue, load_catalogue
from jiti.tasks.task import Task

ProposalSource = Literal["sim", "signal", "vlm"]
"""Who proposes: the predicates that a simulator traced, the recording's own numbers, or a vision-language model."""
ANNOTATORS: dict[ProposalSource, str] = {
    "sim": simulator.ANNOTATOR,
    "signal": signals.ANNOTATOR,
    "vlm": vlm.ANNOTATOR,
}
"""Partition of each one's proposals."""


@dataclass(frozen=True, slots=True)
class Proposer:
    """Call it with an episode's id. Everything it needs is opened where it is called, once a process."""

    source: str
    """Of the recordings, as `open_reader` takes it."""
    labels_dir: Path
    tasks: tuple[Path, ...] = ()
    by: ProposalSource = "signal"
    fuse: bool = True
    stages: tuple[vlm.Stage, ...] = ("segments", "verdicts")
    settings: Settings | None = None
    """Of the model, for `vlm`."""

    def __call__(self, episode_id: str) -> "Proposed":
        """What is wrong with an episode is in the answer; raises SaveFailed, UsageError, which concern them all."""
        try:
            opened = _opened(self.source, self.tasks)
            episode = opened.reader.open(episode_id)
            task = opened.catalogue.for_episode(episode)
            recording = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
            if self.by != "vlm":
                return Proposed(recording, tuple(self._without_model(episode, task)))
            return self._with_model(episode, task, recording)
        except (SaveFailed, UsageError):
            raise
        except JitiError as error:
            return Proposed(None, (), (str(error),))
        except Exception as error:  # a bug in a decoder must not stop a night's run
            logging.getLogger(__name__).exception("%s", episode_id)
            return Proposed(None, (), (f"{type(error).__name__}: {error}",))

    def _with_model(self, episode: Episode, task: Task, recording: Recording) -> "Proposed":
        settings = self.settings or Settings()
        asker = _asker(settings, self.labels_dir)
        notes = read_notes(notes_path(self.labels_dir, episode.episode_id), episode.fingerprint)
        try:
            vlm.complete(notes, episode, task, asker, settings, self.stages)
        except SourceError as error:
            # What was asked before the damaged picture was met is kept, and was paid for.
            return Proposed(None, (), (str(error),), notes, asker.take_usage())
        segments = vlm.segments_of(notes, episode, task, partial(read_calibration, self.labels_dir))
        failures = tuple(f"{name}: {why}" for name, itc in notes.itcs.items() for why in itc.failures)
        return Proposed(recording, tuple(segments), failures, notes, asker.take_usage())

    def _without_model(self, episode: Episode, task: Task) -> list[Segment]:
        if self.by == "sim":
            return simulator.propose_from_simulator(episode, task)
        readings = Readings(episode)
        measured = {}
        for itc in task.itcs:
            with suppress(CatalogueError):  # a goal that cannot be read leaves the other ITCs as they are
                measured[itc.itc_id] = decide_by_numbers(episode, itc, readings)
        return signals.propose_segments(episode, task, measured=measured, fuse=self.fuse)


@dataclass(frozen=True, slots=True)
class Proposed:
    """For one episode."""

    recording: Recording | None
    """None where the episode could not be read; `failures` says why."""
    segments: tuple[Segment, ...]
    failures: tuple[str, ...] = ()
    notes: Notes | None = None
    """What a model said, to be kept."""
    usage: Usage = NOTHING


@dataclass(frozen=True, slots=True)
class _Opened:
    reader: EpisodeReader
    catalogue: Catalogue


_once = threading.RLock()


def _opened(source: str, tasks: tuple[Path, ...]) -> _Opened:
    with _once:
        return _open(source, tasks)


def _asker(settings: Settings, labels_dir: Path) -> Asker:
    """One model a process, however many threads ask it."""
    with _once:
        return _load(settings, labels_dir)


@lru_cache(maxsize=4)
def _open(source: str, tasks: tuple[Path, ...]) -> _Opened:
    return _Opened(open_reader(source), load_catalogue(*tasks))


@lru_cache(maxsize=1)
def _load(settings: Settings, labels_dir: Path) -> Asker:
    return Asker(settings.backend(), AnswerCache(labels_dir / "vlm" / "answers"))
