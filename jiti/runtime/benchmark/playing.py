"""tau and rollouts: `jiti.runtime.rollout` for every cell, on all cores.

Where there are many groups of cells, each core plays groups of its own, for to start a process takes longer than an
episode; where there are few, a group's episodes are spread over the cores.
"""

import threading
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from jiti.durable import make_folder
from jiti.errors import SourceError
from jiti.progress import Progress
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.plan import RolloutPlan, label_of
from jiti.runtime.rollout.plan_file import TAU_FILE
from jiti.runtime.rollout.result import ROLLOUTS
from jiti.runtime.rollout.run import run_rollouts
from jiti.runtime.rollout.tau import (
    Calibration,
    calibrate,
    load_calibrations,
    looking,
    looking_folder,
    save_calibration,
    tau_path,
)
from jiti.runtime.workers import in_processes
from jiti.tasks.catalogue import Catalogue

POLL_S = 2.0


@dataclass(frozen=True)
class Game:
    """Some guidances of one policy with one critic on one task."""

    plan: RolloutPlan
    folder: Path
    episodes: int
    record: bool = False

    @property
    def rollouts(self) -> int:
        return self.episodes * len(self.plan.labels)

    def played(self) -> int:
        """Rollouts that are there, as far as names tell."""
        return sum(
            (self.folder / label / f"{self.plan.stem(number)}.json").exists()
            for label in self.plan.labels
            for number in range(self.episodes)
        )

    def left(self) -> int:
        """Rollouts to play; 1 where all are there and only the table of them is not: a run was killed in between."""
        missing = self.rollouts - self.played()
        return missing or int(not self._tabled())

    def _tabled(self) -> bool:
        try:
            rows = pq.read_metadata(self.folder / ROLLOUTS).num_rows
        except (OSError, pa.ArrowException):
            return False
        return rows >= len(list(self.folder.glob("*/[!.]*.json")))


def guidance_of(column: Column, plan: BenchmarkPlan, tau: float | None) -> Guidance:
    """What a column does at each decision; `tau` is the calibrated one, before its multiple."""
    scaled = None if tau is None or column.method != "jiti" else tau * column.tau_scale
    rollouts = plan.rollouts
    return Guidance(column.method, column.pick, rollouts.candidates, rollouts.window, scaled)


def label(column: Column) -> str:
    """Name of a column's rollouts in the folder of its group."""
    return label_of(Guidance(column.method, column.pick, tau=0.0))


@dataclass(frozen=True)
class Table:
    """What games are made of: who plays, where."""

    work: Work
    plan: BenchmarkPlan
    catalogue: Catalogue
    assets: str | None
    record: bool = False

    def game(self, stage: Stage, columns: Sequence[Column], tau: float | None) -> Game:
        """The cells of a stage of rollouts."""
        guidances = tuple({label(c): guidance_of(c, self.plan, tau) for c in columns}.values())
        plan = self._plan(stage, stage.inputs["task"], self.plan.seed, guidances)
        return Game(plan, self.work.folder(stage), self.plan.episodes, self.record)

    def looking(self, stage: Stage) -> list[Game]:
        """Unguided episodes, in which the critic values the default chunk, for a stage of tau; one game a task."""
        games = []
        for scene in stage.inputs["tasks"]:
            plan = self._plan(stage, scene["task"], self.plan.tau.seed)
            folder = looking_folder(self.work.folder(stage), plan)
            games.append(Game(looking(plan, self.plan.rollouts.window), folder, self.plan.tau.episodes))
        return games

    def find_tau(self, stage: Stage) -> Calibration:
        """tau of episodes that are played, kept in the stage's folder and with the critic. Raises JitiError."""
        games = self.looking(stage)
        found = calibrate(
            [game.plan for game in games],
            self.work.folder(stage),
            rate=self.plan.tau.rate,
            window=self.plan.rollouts.window,
            episodes=self.plan.tau.episodes,
            workers=1,
        )
        critic = games[0].plan.critic
        assert critic is not None
        for path in {self.work.folder(stage) / TAU_FILE, tau_path(critic, self.work.folder(stage))}:
            save_calibration(path, found)
        return found

    def _plan(
        self, stage: Stage, task: str, seed: int, guidances: tuple[Guidance, ...] = (Guidance("none"),)
    ) -> RolloutPlan:
        """With the policy and, where there is one, the critic that a stage needs."""
        critic = next((self.work.folder(needed) for needed in stage.needs if needed.kind == "critics"), None)
        return RolloutPlan(
            self.catalogue.task(task),
            str(self.work.folder(stage.needed("policies"))),
            str(critic) if critic else None,
            guidances,
            seed,
            self.plan.data.start,
            self.assets,
            self.plan.data.cameras,
            self.plan.rollouts.most_steps,
            self.plan.rollouts.device,
        )


def kept_tau(folder: Path) -> float:
    """Of a calibration's folder. Raises SourceError."""
    try:
        return load_calibrations(folder / TAU_FILE)[-1].tau
    except (SourceError, IndexError) as error:
        raise SourceError(
            f"{folder} has no tau that can be read. Delete that folder, and tau is found anew."
        ) from error


def play_all(games: Sequence[Game], workers: int, progress: Progress) -> None:
    """Play what is missing. Raises JitiError; episodes that are whole are kept."""
    missing = [game for game in games if game.left()]
    if not missing:
        return
    for game in missing:
        make_folder(game.folder)
    if len(missing) < 2 * workers or workers == 1:
        for place, game in enumerate(missing):

            def part(share: float, what: str, place: int = place) -> None:
                progress((place + share) / len(missing), what)

            play(game, workers, part)
        return
    # Those with many episodes first, so that no core plays alone for long at the end.
    queue = sorted(missing, key=lambda game: game.played() - game.rollouts)
    with _counted(missing, progress), closing(in_processes(_in_worker, queue, workers, _name)) as done:
        for _ in done:
            pass


def play(game: Game, workers: int, progress: Progress | None = None) -> None:
    """Play a game's missing episodes."""
    run_rollouts(game.plan, game.folder, episodes=game.episodes, workers=workers, record=game.record, progress=progress)


def _in_worker(game: Game) -> None:
    play(game, 1)


def _name(game: Game) -> str:
    return game.folder.name


class _counted:
    """Tells, now and then, how many of some games' rollouts are there."""

    def __init__(self, games: Sequence[Game], progress: Progress) -> None:
        self._games, self._progress = games, progress
        self._before = sum(game.played() for game in games)
        self._total = sum(game.rollouts for game in games)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _watch(self) -> None:
        while not self._end.wait(POLL_S):
            count = sum(game.played() for game in self._games)
            share = (count - self._before) / max(1, self._total - self._before)
            self._progress(share, f"played {count} of {self._total} rollouts")

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_error: object) -> None:
        self._end.set()
        self._thread.join()
