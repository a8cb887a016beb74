"""Cells of a table, read from `rollouts.parquet`, and what is computed of them: rates, intervals, paired tests."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.errors import SourceError
from jiti.runtime.benchmark.plan import Column
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.rollout.result import ROLLOUTS
from jiti.runtime.rollout.summary import bootstrap_interval, mcnemar, wilson

_COLUMNS = ["label", "seed", "success", "elegant", "decisions", "interventions", "problems"]
_TRAINED = {"policies": "policy", "critics": "critic"}
"""Columns with fingerprints, by the kind of stage that made what played."""
_TIMES = ["observe_s", "sample_s", "score_s", "wall_s"]


@dataclass(frozen=True, slots=True)
class Cell:
    """A column on one task with one trained policy, and where its rollouts are."""

    column: Column
    task: str
    seed: int
    """Of the policy's training."""
    stage: Stage
    label: str


@dataclass(frozen=True, slots=True)
class One:
    """One rollout."""

    task: str
    training: int
    """Seed of the policy's training."""
    seed: int
    """Of the initial state and of the noise."""
    success: bool
    elegant: bool
    decisions: int
    interventions: int
    problems: int
    decided_s: float
    """Seconds that policy and critic took."""
    wall_s: float


@dataclass(frozen=True)
class Results:
    """Whole cells by column, task and training seed; one that lacks a rollout is not among them."""

    cells: Mapping[tuple[str, str, int], Sequence[One]]
    wanted: Sequence[tuple[str, str, int]]
    """All that the plan has."""
    episodes: int
    """Of a cell."""

    def missing(self, column: str | None = None) -> list[tuple[str, str, int]]:
        """Cells that are not there, of one column or of all."""
        return [key for key in self.wanted if key not in self.cells and column in (None, key[0])]

    def of(self, column: Column, tasks: Iterable[str]) -> list[One] | None:
        """All rollouts of a column on some tasks, of all its training seeds; None where a cell is missing."""
        found: list[One] = []
        for task in tasks:
            for seed in column.seeds:
                cell = self.cells.get((column.name, task, seed))
                if cell is None:
                    return None
                found += cell
        return found or None


def read_cells(cells: Sequence[Cell], folders: Mapping[str, Path], *, first: int, episodes: int) -> Results:
    """The rollouts with seeds `first` to `first + episodes - 1` of each cell. `folders` are by the key of the stage.

    Raises SourceError for a table that cannot be read, or that has a rollout twice, and where a policy or critic of the
    plan played with the weights of two trainings.
    """
    seeds = range(first, first + episodes)
    tables: dict[str, pa.Table | None] = {}
    whole: dict[tuple[str, str, int], list[One]] = {}
    for cell in cells:
        key = (cell.column.name, cell.task, cell.seed)
        if cell.stage.key not in tables:
            tables[cell.stage.key] = _table(folders[cell.stage.key] / ROLLOUTS)
        table = tables[cell.stage.key]
        own = _rollouts(table, cell, seeds) if table is not None else []
        if len(own) == episodes:
            whole[key] = own
    _check_trainings(cells, tables, folders, seeds)
    wanted = [(cell.column.name, cell.task, cell.seed) for cell in cells]
    return Results(whole, wanted, episodes)


def _table(path: Path) -> pa.Table | None:
    if not path.exists():
        return None
    try:
        return pq.read_table(path, columns=[*_COLUMNS, *_TIMES, *_TRAINED.values()])
    except (OSError, pa.ArrowException) as error:
        raise SourceError(
            f"{path} cannot be read: {str(error)[:200]}. Delete its folder, and it is played anew."
        ) from error


def _rollouts(table: pa.Table, cell: Cell, seeds: range) -> list[One]:
    found: dict[int, One] = {}
    for row in table.to_pylist():
        if row["label"] != cell.label or row["seed"] not in seeds:
            continue
        if row["seed"] in found:
            raise SourceError(f"{cell.stage.folder} has the rollout of seed {row['seed']} twice. Delete that folder.")
        found[row["seed"]] = One(
            cell.task,
            cell.seed,
            row["seed"],
            row["success"],
            row["elegant"],
            row["decisions"],
            row["interventions"],
            row["problems"],
            row["observe_s"] + row["sample_s"] + row["score_s"],
            row["wall_s"],
        )
    return [found[seed] for seed in sorted(found)]


def _check_trainings(
    cells: Sequence[Cell], tables: Mapping[str, pa.Table | None], folders: Mapping[str, Path], seeds: range
) -> None:
    """Raises SourceError where a policy or critic was deleted and trained again, and played before and after that."""
    found: dict[str, dict[str, dict[str, None]]] = {}
    for cell in cells:
        table = tables[cell.stage.key]
        if table is None:
            continue
        for needed in (stage for stage in cell.stage.needs if stage.kind in _TRAINED):
            played = found.setdefault(needed.folder, {})
            for row in table.select(["label", "seed", _TRAINED[needed.kind]]).to_pylist():
                mark = row[_TRAINED[needed.kind]]
                if row["label"] == cell.label and row["seed"] in seeds and mark:
                    played.setdefault(mark, {})[str(folders[cell.stage.key])] = None
    for name, played in found.items():
        if len(played) > 1:
            told = "; ".join(f"{mark} in {', '.join(where)}" for mark, where in played.items())
            raise SourceError(
                f"{name} was trained again after something was played with it, and what different weights played is "
                f"not compared: {told}. Delete the folders of the older weights, and they are played anew."
            )


@dataclass(frozen=True, slots=True)
class Estimate:
    """A share with its 95% interval."""

    count: int
    of: int
    interval: tuple[float, float]

    @property
    def value(self) -> float:
        return self.count / self.of


def rate(rollouts: Sequence[One], outcome: str = "elegant") -> Estimate:
    """Share of rollouts, of which there must be one; tasks have the same number of them, so that it is the average over
    tasks as well.

    The interval is Wilson's where one policy played. Where several did, it is of a bootstrap over initial states within
    tasks, in which the policies of a state stay together; how policies differ is not in it. Where no state differs from
    another, which leaves a bootstrap nothing to draw from, it is Wilson's with each state counted once.
    """
    by_state: dict[tuple[str, int], list[bool]] = {}
    for one in rollouts:
        by_state.setdefault((one.task, one.seed), []).append(bool(getattr(one, outcome)))
    count, states = sum(map(sum, by_state.values())), len(by_state)
    if states == len(rollouts):
        return Estimate(count, states, wilson(count, states))
    sums = np.array([sum(values) for values in by_state.values()], float)
    if np.ptp(sums) == 0:
        return Estimate(count, len(rollouts), wilson(round(count * states / len(rollouts)), states))
    interval = bootstrap_interval(sums * states / len(rollouts), [task for task, _ in by_state])
    return Estimate(count, len(rollouts), interval)


@dataclass(frozen=True, slots=True)
class Effort:
    """What guidance cost."""

    interventions: float
    """An episode."""
    share: float
    """Of decisions."""
    decision_ms: float
    """Of policy and critic, for a decision: a whole chunk."""


def effort(rollouts: Sequence[One]) -> Effort:
    """Over all rollouts."""
    interventions = sum(one.interventions for one in rollouts)
    decisions = max(1, sum(one.decisions for one in rollouts))
    return Effort(
        interventions / max(1, len(rollouts)),
        interventions / decisions,
        1e3 * sum(one.decided_s for one in rollouts) / decisions,
    )


@dataclass(frozen=True, slots=True)
class Paired:
    """Two columns on the same policies and initial states."""

    pairs: int
    only_first: int
    only_second: int
    difference: float
    """Rate of the second less that of the first."""
    interval: tuple[float, float]
    """95%, by a bootstrap over initial states within each task; policies of one state stay together."""
    p: float
    """Of an exact sign-flip test over initial states, two-sided; policies of one state stay together."""
    p_each: Mapping[int, float]
    """Of an exact McNemar test for each training seed alone."""


def paired(first: Sequence[One], second: Sequence[One], outcome: str = "elegant") -> Paired | None:
    """Compare on what both have played: task, training seed and initial state. None where that is nothing."""
    a, b = (
        {(one.task, one.training, one.seed): bool(getattr(one, outcome)) for one in many} for many in (first, second)
    )
    shared = sorted(a.keys() & b.keys())
    if not shared:
        return None
    by_state: dict[tuple[str, int], list[int]] = {}
    for task, training, seed in shared:
        key = (task, training, seed)
        by_state.setdefault((task, seed), []).append(b[key] - a[key])
    sums = np.array([sum(values) for values in by_state.values()], float)
    scale = len(sums) / len(shared)
    low, high = bootstrap_interval(sums * scale, [task for task, _ in by_state])
    counts = {None: _discordant(a, b, shared)} | {
        training: _discordant(a, b, [key for key in shared if key[1] == training])
        for training in sorted({key[1] for key in shared})
    }
    only_a, only_b = counts[None]
    return Paired(
        len(shared),
        only_a,
        only_b,
        (only_b - only_a) / len(shared),
        (low, high),
        sign_flip([int(value) for value in sums]),
        {training: mcnemar(*split) for training, split in counts.items() if training is not None},
    )


def sign_flip(sums: Sequence[int]) -> float:
    """How often the total of these numbers is at least as far from 0 when fair coins give each its sign; 1 where all
    are 0. Of 1, 0 and -1 it is McNemar's test.

    The distribution is exact for any number of them: that of a sum of independent whole numbers, one after the other.
    """
    chances = np.ones(1)  # of totals from -reach to reach
    for size in (abs(value) for value in sums if value):
        wider = np.zeros(len(chances) + 2 * size)
        wider[: len(chances)] += chances / 2
        wider[2 * size :] += chances / 2
        chances = wider
    reach = len(chances) // 2
    far = np.abs(np.arange(-reach, reach + 1)) >= abs(sum(sums))
    return min(1.0, float(chances[far].sum()))


def _discordant(
    a: Mapping[tuple[str, int, int], bool],
    b: Mapping[tuple[str, int, int], bool],
    keys: Iterable[tuple[str, int, int]],
) -> tuple[int, int]:
    keys = list(keys)
    return sum(a[key] and not b[key] for key in keys), sum(b[key] and not a[key] for key in keys)
