"""Which split each episode goes to: the one that a dataset of jiti recorded, or one that is dealt now."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from jiti.curate.export.planned import PlannedEpisode
from jiti.curate.export.sources import Source
from jiti.curate.export.split import DEFAULT, SPLITS, UNSEEN, split_episodes
from jiti.episodes.lerobot_index import episode_id_of
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.errors import SourceError, UsageError
from jiti.tasks.catalogue import ids_named


@dataclass(frozen=True, slots=True)
class Dealt:
    """How splits are dealt."""

    shares: tuple[float, float, float] = DEFAULT
    seed: int = 0
    unseen: tuple[str, ...] = ()
    """Tasks, by id, by the last part of one, or by instruction."""
    anew: bool = False
    """Whether episodes that have a recorded split are dealt one as well."""


def splits_file(source: Source) -> Path | None:
    """Where a dataset of jiti recorded splits; None for another source."""
    if not isinstance(source.reader, LeRobotReader):
        return None
    path = source.reader.info.root / "meta" / "jiti" / "episodes.parquet"
    return path if path.is_file() else None


def recorded_splits(sources: Sequence[Source]) -> dict[str, Mapping[str, str]]:
    """Splits by episode id of every source that is a dataset of jiti, by its name. Raises SourceError."""
    found: dict[str, Mapping[str, str]] = {}
    for source in sources:
        path = splits_file(source)
        if path is None:
            continue
        remedy = "Pass --split, --seed or --unseen to deal splits anew."
        try:
            rows = pq.read_table(path, columns=["episode_index", "split"]).to_pylist()
        except (OSError, pa.ArrowException) as error:
            raise SourceError(f"{path} cannot be read ({error}). {remedy}") from error
        if unknown := {row["split"] for row in rows} - {*SPLITS, UNSEEN}:
            there = ", ".join((*SPLITS, UNSEEN))
            raise SourceError(f"{path} has the split {min(map(str, unknown))!r}; there are: {there}. {remedy}")
        found[source.name] = {episode_id_of(row["episode_index"]): row["split"] for row in rows}
    return found


def splits_of(episodes: Sequence[PlannedEpisode], dealt: Dealt, recorded: Mapping[str, Mapping[str, str]]) -> list[str]:
    """A split for each episode, in order. Recorded ones are kept unless all are dealt anew; a task that they hold out
    as `unseen` is unseen in other sources too.

    Raises UsageError for a task of `--unseen` that is not there, and for one that is unseen in one dataset only.
    """
    kept = [None if dealt.anew else recorded.get(e.source, {}).get(e.episode_id) for e in episodes]
    unseen = _unseen_of(episodes, dealt.unseen)
    held_out = {_task(e): e.source for e, split in zip(episodes, kept, strict=True) if split == UNSEEN}
    for episode, split in zip(episodes, kept, strict=True):
        if split not in (None, UNSEEN) and (task := _task(episode)) in held_out:
            raise UsageError(
                f"{task} is unseen in {held_out[task]} and in the split {split} of {episode.source}. Curate them "
                f"apart, or deal splits anew: --split {','.join(f'{share:g}' for share in DEFAULT)} --unseen '{task}'."
            )
    free = [place for place, split in enumerate(kept) if split is None]
    strata = [(_task(episodes[place]), episodes[place].reward) for place in free]
    is_unseen = [task in unseen or task in held_out for task, _ in strata]
    new = dict(zip(free, split_episodes(strata, is_unseen, dealt.shares, dealt.seed), strict=True))
    return [split or new[place] for place, split in enumerate(kept)]


def _unseen_of(episodes: Sequence[PlannedEpisode], names: Sequence[str]) -> set[str]:
    """Those of the episodes' tasks that are meant."""
    by_wording = {wording: _task(e) for e in episodes for wording in (e.instruction, _task(e))}
    tasks = {_task(e) for e in episodes}
    there = ", ".join(sorted(tasks))
    found = set()
    for name in names:
        meant = [by_wording[name]] if name in by_wording else ids_named(name, sorted(tasks))
        if len(meant) > 1:
            raise UsageError(f"--unseen {name} is the end of several tasks' ids: {', '.join(meant)}. Pass one of them.")
        if not meant:
            raise UsageError(f"--unseen {name}: no episode has that task; there are: {there}.")
        found.add(meant[0])
    return found


def _task(episode: PlannedEpisode) -> str:
    return episode.task_id or episode.instruction
