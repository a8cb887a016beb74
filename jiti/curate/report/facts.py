"""What the page tells, read from a curated dataset in one pass over its rows."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jiti.annotate.agreement import ALL_ITCS, Agreement, compare
from jiti.annotate.labels import Labels, read_labels
from jiti.annotate.segment_file import Recording
from jiti.curate.checks import find_suspects
from jiti.curate.export.features import ENVIRONMENT_STATE, STATE
from jiti.curate.suspects import Suspect
from jiti.episodes.lerobot_index import episode_id_of
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.lerobot_rows import to_floats
from jiti.errors import SourceError, UsageError

STATE_ROWS = 20_000
"""Frames that the map of the state space shows, evenly over the dataset. Our choice: a picture has no more points."""
POINTS = 64
"""Frames kept of an episode to find others like it; see `jiti.curate.near_identical`."""
_COLUMNS = ("episode_index", "next.reward", "elegance.annotated", "elegance.mc_return")


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """One episode."""

    index: int
    task: str
    instruction: str
    split: str
    success: bool | None
    frames: int
    elegant: bool | None
    """None where nothing is annotated."""
    first_return: float
    peak_return: float
    annotated: int
    """Frames."""


@dataclass(frozen=True, slots=True)
class Facts:
    """Everything on the page."""

    name: str
    about: dict[str, Any]
    """`meta/jiti/curate.json`."""
    fps: int
    episodes: tuple[EpisodeFacts, ...]
    verdicts: dict[str, Counter[int]]
    """Segments by ITC and verdict."""
    lengths: dict[int, list[int]]
    """Frames of the segments, by verdict."""
    agreements: tuple[Agreement, ...]
    states: dict[str, np.ndarray]
    """(rows, size) of each feature that is mapped, by name; the same frames of all."""
    state_episode: np.ndarray
    """(rows,) the episode of each."""
    suspects: tuple[Suspect, ...]


def gather(dataset: Path) -> Facts:
    """Read a dataset of `jiti curate`. Raises UsageError for another folder, SourceError for a damaged one."""
    own = dataset / "meta" / "jiti" / "curate.json"
    if not own.is_file():
        raise UsageError(
            f"{dataset} is no dataset of jiti curate: it has no meta/jiti/curate.json. Make one with "
            f"`jiti curate SOURCE --out {dataset.name} --report`."
        )
    try:
        about = json.loads(own.read_text())
        told = pq.read_table(own.with_name("episodes.parquet")).to_pylist()
    except (OSError, ValueError) as error:
        raise SourceError(f"{own.parent} cannot be read ({error}). Curate the dataset again.") from error
    reader = LeRobotReader(dataset)
    info = reader.info
    instructions = {ref.episode_id: ref.task or "" for ref in reader.episodes()}
    names = [feature.key for feature in info.features if feature.dtype == "float32"]
    rows = _Rows([key for key in (STATE, ENVIRONMENT_STATE) if key in names], sum(row["frames"] for row in told))
    for path in sorted((dataset / "data").rglob("*.parquet")):
        rows.add(path)
    episodes = tuple(rows.episode(row, instructions) for row in told)
    labels = read_labels(dataset / "meta" / "jiti")
    counted = _counted(labels.segments)
    return Facts(
        name=dataset.absolute().name,
        about=about,
        fps=int(info.fps),
        episodes=episodes,
        verdicts=_verdicts(counted),
        lengths=_lengths(counted),
        agreements=tuple(_agreements(counted, labels)),
        states=rows.states,
        state_episode=rows.state_episode,
        suspects=tuple(_suspects(dataset, labels, about, rows)),
    )


class _Rows:
    """What is kept of the rows, a row group at a time: a group is an episode."""

    def __init__(self, state_names: Sequence[str], total: int) -> None:
        self._every = max(1, -(-total // STATE_ROWS))
        self._judged: dict[int, tuple[float, float, int, bool]] = {}
        self._states: dict[str, list[np.ndarray]] = {name: [] for name in state_names}
        self._state_episode: list[np.ndarray] = []
        self.trajectories: dict[str, np.ndarray] = {}

    def add(self, path: Path) -> None:
        with pq.ParquetFile(path) as file:
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, [*_COLUMNS, *self._states])
                episode, reward, annotated, returns = (
                    to_floats(table[name].combine_chunks(), 1)[:, 0] for name in _COLUMNS
                )
                for index in np.unique(episode).astype(int).tolist():
                    here = episode == index
                    violated = bool((annotated[here] > reward[here]).any())
                    values = returns[here]
                    self._judged[index] = float(values[0]), float(values.max()), int(annotated[here].sum()), violated
                    self._state_episode.append(np.full(-(-int(here.sum()) // self._every), index))
                    for name, kept in self._states.items():
                        width = getattr(table[name].type, "list_size", 1)
                        state = to_floats(table[name].combine_chunks(), width)[here]
                        kept.append(state[:: self._every])
                        if name == next(iter(self._states)):
                            points = np.linspace(0, len(state) - 1, min(POINTS, len(state))).astype(int)
                            self.trajectories[episode_id_of(index)] = state[points].astype(np.float32)

    @property
    def states(self) -> dict[str, np.ndarray]:
        return {name: np.concatenate(kept) for name, kept in self._states.items() if kept}

    @property
    def state_episode(self) -> np.ndarray:
        return np.concatenate(self._state_episode) if self._state_episode else np.empty(0, np.int64)

    def episode(self, row: dict[str, Any], instructions: Mapping[str, str]) -> EpisodeFacts:
        if row["episode_index"] not in self._judged:
            raise SourceError(f"the data has no rows of episode {row['episode_index']}. Curate the dataset again.")
        first, peak, annotated, violated = self._judged[row["episode_index"]]
        return EpisodeFacts(
            index=row["episode_index"],
            task=row["task_id"] or "no task of a catalogue",
            instruction=instructions.get(episode_id_of(row["episode_index"]), ""),
            split=row["split"],
            success=row["success"],
            frames=row["frames"],
            elegant=not violated if annotated else None,
            first_return=first,
            peak_return=peak,
            annotated=annotated,
        )


def _counted(segments: pa.Table) -> pa.Table:
    """Accepted segments with a verdict; the dataset may have been annotated since it was made."""
    return segments.filter((pc.field("status") == "accepted") & pc.field("reward").is_valid())


def _verdicts(counted: pa.Table) -> dict[str, Counter[int]]:
    found: dict[str, Counter[int]] = {}
    for itc, reward in zip(*(counted[c].to_pylist() for c in ("itc_id", "reward")), strict=True):
        found.setdefault(itc, Counter())[reward] += 1
    return dict(sorted(found.items()))


def _lengths(counted: pa.Table) -> dict[int, list[int]]:
    found: dict[int, list[int]] = {1: [], 0: []}
    columns = (counted[c].to_pylist() for c in ("start_frame", "end_frame", "reward"))
    for start, end, reward in zip(*columns, strict=True):
        found[reward].append(end - start + 1)
    return found


def _agreements(counted: pa.Table, labels: Labels) -> Iterator[Agreement]:
    """Of every two annotators that have an episode in common."""
    counts = {name: about.frame_count for name, about in labels.by_episode().items()}
    for a, b in combinations(sorted(set(counted["annotator"].to_pylist())), 2):
        found = compare(counted, counts, a, b)
        if found.episodes and any(itc.itc_id == ALL_ITCS for itc in found.itcs):
            yield found


def _suspects(dataset: Path, labels: Labels, about: dict[str, Any], rows: _Rows) -> list[Suspect]:
    reader = LeRobotReader(dataset)
    recordings = {
        name: Recording(known.frame_count, known.frame_rate_hz, reader.fingerprint(name))
        for name, known in labels.by_episode().items()
    }
    trajectories = rows.trajectories.__getitem__ if rows.trajectories else None
    return find_suspects(labels, recordings=recordings, trajectories=trajectories, gamma=about["gamma"])
