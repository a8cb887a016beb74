"""Everything about a dataset that is known before anything is written: episodes, frames, labels, splits."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from jiti.annotate.segments import Segment
from jiti.curate.export.agree import check_shapes, common_rate
from jiti.curate.export.automatic import map_automatically
from jiti.curate.export.codec import Codec
from jiti.curate.export.digest import digest_of
from jiti.curate.export.features import Feature, Shape, shapes
from jiti.curate.export.filter import Filter
from jiti.curate.export.filter_names import Known, values_told
from jiti.curate.export.frames import Frames, frames_of, moved, whole_rate
from jiti.curate.export.held_out import Dealt, recorded_splits, splits_of
from jiti.curate.export.labels_fit import check_labels, check_recording, nothing_counts
from jiti.curate.export.outcome import recorded_success
from jiti.curate.export.planned import Opened, PlannedEpisode, segments_table
from jiti.curate.export.sources import Source
from jiti.curate.returns import mc_returns
from jiti.curate.rewards import rewards_of
from jiti.curate.verdicts import spans
from jiti.episodes.episode import Episode, EpisodeRef, loss
from jiti.episodes.lerobot_index import episode_id_of
from jiti.errors import LabelError, SourceError, UsageError
from jiti.progress import Progress
from jiti.tasks.generic import GENERIC
from jiti.tasks.task import Task

GAP_PERIODS = 1.5
"""A picture that comes later than this after the one before it is late. Our choice: one frame was lost."""
NO_INSTRUCTION = "no instruction recorded"
"""LeRobot wants a text for every episode."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What of the sources goes in, and how; see `jiti curate --help`."""

    rule: str
    """In words, for the metadata."""
    gamma: float
    fps: int | None = None
    codec: Codec | None = None
    """None to copy videos where that can be, and else h264."""
    keep_unlabelled: bool = False
    features: tuple[Feature, ...] | None = None
    condition: Filter | None = None
    dealt: Dealt = field(default_factory=Dealt)


@dataclass(frozen=True, slots=True)
class Plan:
    """The dataset to be."""

    episodes: tuple[PlannedEpisode, ...]
    shapes: Mapping[str, Shape]
    fps: int
    resampled: bool
    tasks: tuple[Task, ...]
    """That episodes have, from the catalogues; generic ones are not among them."""
    unlabelled: int
    """Episodes left out because nothing counts of them."""
    filtered: int
    """Episodes left out by the filter."""
    splits_kept: tuple[str, ...]
    """Sources whose recorded splits are kept."""
    notes: tuple[str, ...]
    """What a person should know."""
    digest: str
    """Changes when an input does: recordings, labels that count, tasks, mapping, rate, codec, this version of jiti."""

    @property
    def instructions(self) -> list[str]:
        """In the order of their numbers in the dataset."""
        return list(dict.fromkeys(episode.instruction for episode in self.episodes))


def make_plan(sources: Sequence[Source], choice: Choice, progress: Progress = lambda _s, _w: None) -> Plan:
    """Open every episode that has labels, once. Raises JitiError for what does not fit together, before any output."""
    if choice.condition:
        choice = replace(choice, condition=choice.condition.completed(Known.of(sources)))
    notes: list[str] = []
    found: list[Opened] = []
    unlabelled = 0
    total = sum(len(source.reader.episodes()) for source in sources)
    done = 0
    recorded = {} if choice.dealt.anew else recorded_splits(sources)
    for source in sources:
        check_labels(source)
        for ref in source.reader.episodes():
            done += 1
            rows = source.counted.segments.get(ref.episode_id, ())
            if not rows and not choice.keep_unlabelled:
                unlabelled += 1
                continue
            progress(done / total, f"planning {ref.title}")
            episode = _open(source, ref, labelled=bool(rows), notes=notes)
            if episode is None:
                continue
            notes += _doubts(f"{source.name}, {ref.title}", episode, choice)
            found.append(_plan_episode(source, ref, episode, rows, choice))
        if not any(opened.planned.source == source.name for opened in found):
            raise nothing_counts(source, choice.rule)
    fps = choice.fps or common_rate(found)
    check_shapes(found)
    return _finished(found, fps, choice, unlabelled, recorded, notes)


def _open(source: Source, ref: EpisodeRef, *, labelled: bool, notes: list[str]) -> Episode | None:
    try:
        episode = source.reader.open(ref.episode_id)
    except SourceError as error:
        if labelled:
            raise
        notes.append(f"{ref.title} was left out, because it cannot be opened: {error}")
        return None
    if labelled:
        check_recording(source, ref, episode)
    if not episode.clock.frame_count:
        raise SourceError(f"{source.name}, {ref.title}: it has no frames. Leave it out: move it or its labels away.")
    return episode


def _doubts(title: str, episode: Episode, choice: Choice) -> Iterator[str]:
    """What a person should know of a recording that goes in."""
    if (missing := loss(episode)) is not None:
        yield f"{title}: a part of it is missing: {missing}"
    steps = np.diff(episode.clock.frame_ns)
    gaps = int((steps > GAP_PERIODS * 1e9 / episode.clock.rate_hz).sum())
    if gaps and choice.fps is None:
        yield (
            f"{title}: {gaps} times the next picture came late, and LeRobot's frames are evenly spaced. "
            f"--fps {round(episode.clock.rate_hz)} puts them on an even clock."
        )


def _plan_episode(
    source: Source,
    ref: EpisodeRef,
    episode: Episode,
    rows: Sequence[tuple[str, Segment]],
    choice: Choice,
) -> Opened:
    title = f"{source.name}, {ref.title}"
    task = source.catalogue.for_episode(episode)
    features = choice.features or map_automatically(episode, title)
    last = episode.clock.frame_count - 1
    if outside := [segment for _, segment in rows if segment.end_frame > last]:
        raise LabelError(
            f"{title}: segment {outside[0].segment_id} of {outside[0].itc_id} ends at frame {outside[0].end_frame}; "
            f"the last frame is {last}. `jiti annotate` shows it."
        )
    fps = choice.fps or whole_rate(episode.clock.rate_hz, title)
    frames = frames_of(episode.clock, choice.fps)
    kept = tuple(
        (annotator, segment)
        for (annotator, _), segment in zip(rows, moved([s for _, s in rows], frames, "", fps), strict=True)
    )
    values = _judge(kept, frames, choice.gamma)
    instruction = episode.task or (task.instruction if task.task_id != GENERIC else "") or NO_INSTRUCTION
    planned = PlannedEpisode(
        source=source.name,
        episode_id=ref.episode_id,
        title=ref.title,
        fingerprint=episode.fingerprint,
        instruction=instruction,
        task=None if task.task_id == GENERIC else task,
        success=recorded_success(episode),
        frames=frames.count,
        segments=kept,
        features=features,
        **values,
    )
    return Opened(planned, shapes(features, episode, title), episode.clock.rate_hz)


def _judge(rows: Sequence[tuple[str, Segment]], frames: Frames, gamma: float) -> dict[str, Any]:
    counts = {"": frames.count}
    found = spans(segments_table(rows), counts)
    rewards = rewards_of(found, counts)
    returns = mc_returns(rewards.reward, rewards.offsets, gamma)
    verdicts: dict[str, int] = {}
    for itc, verdict in zip(found.itc.tolist(), found.verdict.tolist(), strict=True):
        name = found.itc_ids[itc]
        verdicts[name] = min(verdict, verdicts.get(name, 1))
    return {
        "reward": min(verdicts.values()) if verdicts else None,
        "first_return": float(returns[0]),
        "peak_return": float(returns.max()),
        "annotated": float(rewards.annotated.mean()),
        "verdicts": verdicts,
    }


def _finished(
    found: Sequence[Opened],
    fps: int,
    choice: Choice,
    unlabelled: int,
    recorded: Mapping[str, Mapping[str, str]],
    notes: list[str],
) -> Plan:
    episodes = [opened.planned for opened in found]
    # Before the filter, so that filtered and whole data have the same episodes held out.
    names = splits_of(episodes, choice.dealt, recorded)
    episodes = [replace(episode, split=name) for episode, name in zip(episodes, names, strict=True)]
    kept = [episode for episode in episodes if choice.condition is None or choice.condition(episode.values(fps))]
    if not kept and choice.condition is not None:
        told = values_told(choice.condition.names, [episode.values(fps) for episode in episodes])
        raise UsageError(
            f"--filter {choice.condition.text!r} leaves none of {len(episodes)} episodes. What there is: {told}."
        )
    placed = list(_placed(kept, fps))
    return Plan(
        tuple(placed),
        found[0].shapes,
        fps,
        choice.fps is not None,
        tuple({task.task_id: task for episode in placed if (task := episode.task)}.values()),
        unlabelled,
        len(episodes) - len(kept),
        tuple(name for name in recorded if any(episode.source == name for episode in placed)),
        tuple(notes),
        digest_of(placed, found[0].shapes, [fps, choice.gamma, choice.rule, choice.codec and asdict(choice.codec)]),
    )


def _placed(kept: Sequence[PlannedEpisode], fps: int) -> Iterator[PlannedEpisode]:
    first = 0
    for index, episode in enumerate(kept):
        name = episode_id_of(index)
        rows = tuple((annotator, replace(segment, episode_id=name)) for annotator, segment in episode.segments)
        yield replace(episode, index=index, first_frame=first, segments=rows)
        first += episode.frames
