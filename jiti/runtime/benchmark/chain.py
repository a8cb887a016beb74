"""The chain: what is missing of a plan's stages, in their order, on all cores, going on where a run was stopped."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from time import monotonic
from typing import Any

from jiti.durable import make_folder
from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.runtime.benchmark.cells import Cell, Results, read_cells
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.make import (
    accept_all,
    make_dataset,
    make_labels,
    make_recordings,
    recording_names,
    recordings_plan,
    reviewed,
)
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column
from jiti.runtime.benchmark.playing import Game, Table, kept_tau, label, play_all
from jiti.runtime.benchmark.remaining import Remaining
from jiti.runtime.benchmark.stages import KINDS, Kind, Stage, Stages, in_order
from jiti.runtime.benchmark.training import TRAINED, steps, train_all
from jiti.runtime.sim.libero import pack_fingerprint
from jiti.tasks.catalogue import Catalogue

Say = Callable[[str], None]


@dataclass(frozen=True)
class Chain:
    """A plan at work in a folder; `columns` and `tasks` are those that are played."""

    work: Work
    plan: BenchmarkPlan
    catalogue: Catalogue
    columns: tuple[Column, ...]
    tasks: tuple[str, ...]
    assets: str | None = None
    """Asset pack in the place of the plan's."""
    workers: int = 1
    record: bool = False
    """Whether rollouts are recorded as well."""
    annotator: str = ""
    """In whose name the simulator's proposals are accepted; without one they count as they are, as proposals."""
    say: Say = field(default=lambda _what: None)

    @cached_property
    def stages(self) -> Stages:
        # As files, and not as they will be: a dataset depends on what people have decided by now.
        seen: dict[str, str] = {}

        def decided(stage: Stage) -> str:
            if stage.key not in seen:
                names = recording_names(self.plan, stage.name)
                seen[stage.key] = reviewed(self.work.folder(stage), names)
            return seen[stage.key]

        return Stages(self.plan, self.catalogue, pack_fingerprint(self.pack), decided, self.work.flat)

    @property
    def pack(self) -> str:
        return self.assets or self.plan.data.assets

    @cached_property
    def table(self) -> Table:
        return Table(self.work, self.plan, self.catalogue, self.pack, self.record)

    def cells(self, columns: Iterable[Column] | None = None, tasks: Iterable[str] | None = None) -> list[Cell]:
        """Of some columns and tasks; by default of the whole plan."""
        tasks = self.plan.tasks if tasks is None else tuple(tasks)
        return [
            Cell(column, task, seed, self.stages.rollouts(column, task, seed), label(column))
            for column in columns or self.plan.columns
            for task in tasks
            for seed in column.seeds
        ]

    def missing(self) -> list[Stage]:
        """Stages to do, in their order: rollouts that lack an episode, and what they need that is not there."""
        wanted = self._groups()

        def undone(stage: Stage) -> list[Stage]:
            return [stage, *(one for needed in stage.needs if not self.work.done(needed) for one in undone(needed))]

        leaves = [stage for stage, columns in wanted.values() if self._left(stage, columns)]
        keys = {stage.key for leaf in leaves for stage in undone(leaf)}
        return [stage for stage in in_order(leaves) if stage.key in keys]

    def run(self, only: Sequence[str] = (), progress: Progress = lambda _share, _what: None) -> None:
        """Do what is missing, of some kinds or of all. Raises JitiError; what is finished is kept.

        Raises UsageError where a kind that is left out is needed by one that is asked for.
        """
        kinds: list[Kind] = [kind for kind in KINDS if not only or kind in only]
        missing = self.missing()
        todo: dict[Kind, list[Stage]] = {kind: [stage for stage in missing if stage.kind == kind] for kind in KINDS}
        self._check_needs(kinds, todo)
        remaining = Remaining(self._units({kind: todo[kind] for kind in kinds}), self.workers, progress)
        make_folder(self.work.out)
        if "record" in kinds:
            self._each(todo["record"], remaining.begin("record"), self._record)
        if "autolabel" in kinds:
            self._each(todo["autolabel"], remaining.begin("autolabel"), self._label)
            # Datasets depend on what was accepted meanwhile.
            self.__dict__.pop("stages", None)
            missing = self.missing()
            todo |= {kind: [stage for stage in missing if stage.kind == kind] for kind in KINDS[2:]}
        if "curate" in kinds:
            self._each(todo["curate"], remaining.begin("curate"), self._curate)
        training = [stage for kind in TRAINED if kind in kinds for stage in todo[kind]]
        if training:
            tell = remaining.begin("policies")
            train_all(self.work, training, self.plan, self.workers, self.work.finish, tell)
        if "tau" in kinds and todo["tau"]:
            self._calibrate(todo["tau"], remaining.begin("tau"))
        if "rollouts" in kinds and todo["rollouts"]:
            play_all(self._games(todo["rollouts"]), self.workers, remaining.begin("rollouts"))

    def results(self) -> Results:
        """What is there of the whole plan, whichever columns and tasks this run was about."""
        cells = self.cells()
        folders = {cell.stage.key: self.work.folder(cell.stage) for cell in cells}
        return read_cells(cells, folders, first=self.plan.seed, episodes=self.plan.episodes)

    def _groups(self) -> dict[str, tuple[Stage, list[Column]]]:
        """Stages of rollouts that are asked for, each with the columns that lie there."""
        found: dict[str, tuple[Stage, list[Column]]] = {}
        for cell in self.cells(self.columns, self.tasks):
            columns = found.setdefault(cell.stage.key, (cell.stage, []))[1]
            if cell.column not in columns:
                columns.append(cell.column)
        return found

    def _left(self, stage: Stage, columns: Sequence[Column]) -> int:
        return self.table.game(stage, columns, float("inf")).left()

    def _games(self, stages: Sequence[Stage]) -> list[Game]:
        groups = self._groups()
        games = []
        for stage in stages:
            tau = next((kept_tau(self.work.folder(one)) for one in stage.needs if one.kind == "tau"), None)
            games.append(self.table.game(stage, groups[stage.key][1], tau))
        return games

    def _units(self, todo: Mapping[Kind, Sequence[Stage]]) -> dict[Kind, float]:
        groups = self._groups()
        episodes, plan = self.plan.data.episodes, self.plan
        units: dict[Kind, float] = dict.fromkeys(KINDS, 0.0)
        for kind, stages in todo.items():
            for stage in stages:
                if kind in ("record", "autolabel"):
                    units[kind] += episodes
                elif kind == "curate":
                    units[kind] += episodes * len(stage.needs)
                elif kind in TRAINED:  # side by side with policies
                    units["policies"] += steps(stage)
                elif kind == "tau":
                    units[kind] += plan.tau.episodes * len(stage.inputs["tasks"])
                else:
                    units[kind] += self._left(stage, groups[stage.key][1])
        return units

    def _check_needs(self, kinds: Sequence[Kind], todo: Mapping[Kind, Sequence[Stage]]) -> None:
        for kind in kinds:
            for stage in todo[kind]:
                for needed in stage.needs:
                    if needed.kind not in kinds and not self.work.done(needed):
                        raise UsageError(
                            f"--only {kind} needs what {needed.kind} makes ({needed.name}), and that is not there in "
                            f"{self.work.out}. Run it first with --only {needed.kind}, or leave --only out."
                        )

    def _each(
        self, stages: Sequence[Stage], progress: Progress, make: Callable[[Stage, Progress], Mapping[str, Any]]
    ) -> None:
        for place, stage in enumerate(stages):

            def part(share: float, what: str, place: int = place) -> None:
                progress((place + share) / len(stages), what)

            began = monotonic()
            made = make(stage, part)
            self.work.finish(stage, monotonic() - began, made)

    def _record(self, stage: Stage, progress: Progress) -> Mapping[str, Any]:
        plan = recordings_plan(self.plan, self.catalogue.task(stage.inputs["task"]), self.pack)
        make_folder(self.work.folder(stage))
        return make_recordings(
            plan,
            self.work.folder(stage),
            episodes=self.plan.data.episodes,
            workers=self.workers,
            progress=progress,
        )

    def _label(self, stage: Stage, progress: Progress) -> Mapping[str, Any]:
        folder = self.work.folder(stage.needs[0])
        made = make_labels(folder, self.plan.data.episodes, progress)
        if self.annotator:
            count = accept_all(folder, recording_names(self.plan, stage.name), self.annotator)
            self.say(f"{count} proposals of the simulator were accepted in the name of {self.annotator}")
        return made

    def _curate(self, stage: Stage, progress: Progress) -> Mapping[str, Any]:
        return make_dataset(self.work, stage, self.plan, progress)

    def _calibrate(self, stages: Sequence[Stage], progress: Progress) -> None:
        began = monotonic()
        for stage in stages:
            make_folder(self.work.folder(stage))
        games = [game for stage in stages for game in self.table.looking(stage)]
        play_all(games, self.workers, progress)
        each = (monotonic() - began) / len(stages)
        for stage in stages:
            found = self.table.find_tau(stage)
            made = {
                "tau": found.tau,
                "rate": found.rate,
                "measured": found.measured,
                "decisions": found.decisions,
                "episodes": found.episodes,
            }
            self.work.finish(stage, each, made)
            self.say(
                f"tau of {stage.name} is {found.tau:.4g}: {found.measured:.1%} of {found.decisions} decisions exceed "
                f"it, {found.rate:.1%} were asked for"
            )
