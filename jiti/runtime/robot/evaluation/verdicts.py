"""A person's verdicts on an episode as labels, so that the annotator, curation and training have them."""

from pathlib import Path

from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES, Segment, new_segment_id
from jiti.annotate.signals import propose_segments
from jiti.annotate.store import LabelStore
from jiti.episodes.episode import Episode
from jiti.episodes.reader import open_reader
from jiti.runtime.robot.evaluation.questions import Answers
from jiti.tasks.task import ITC, Task

NOTE = "Judged after the rollout."
"""By which these rows are known when they are judged again."""


def save_verdicts(path: Path, task: Task, answers: Answers, annotator: str) -> None:
    """Write a segment of source `human` for every ITC of which the person could tell, beside the recording, in the
    place of those of an earlier judgement. It is where signals say that the ITC is decided, else at the end of the
    episode; `jiti annotate` moves it. Raises LabelError, SaveFailed, SourceError."""
    reader = open_reader(path)
    episode = reader.open(reader.episodes()[0].episode_id)
    clock = episode.clock
    about = Recording(clock.frame_count, clock.rate_hz, episode.fingerprint)
    partition = LabelStore(Path(reader.labels_dir)).partition(annotator, episode.episode_id, about)
    places = {segment.itc_id: segment for segment in reversed(propose_segments(episode, task))}
    put = [
        _segment(episode, itc, places.get(itc.itc_id), verdict)
        for itc in task.itcs
        if (verdict := answers.itcs[itc.itc_id]) is not None
    ]
    before = [segment.segment_id for segment in partition.segments if segment.rationale == NOTE]
    partition.apply("judge the rollout", put, before, based_on=partition.version)


def _segment(episode: Episode, itc: ITC, place: Segment | None, verdict: bool) -> Segment:
    clock = episode.clock
    end = place.end_frame if place else clock.frame_count - 1
    start = place.start_frame if place else max(0, end - DEFAULT_WINDOW_FRAMES + 1)
    return Segment(
        new_segment_id(),
        episode.episode_id,
        itc.itc_id,
        str(itc.criterion),
        start,
        end,
        int(clock.frame_ns[start]),
        int(clock.frame_ns[end]),
        reward=int(verdict),
        rationale=NOTE,
    )
