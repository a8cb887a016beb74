"""Rollouts that nobody played, and a chain whose stages only say that they were done."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from jiti.progress import Progress
from jiti.runtime.benchmark import chain as chain_module
from jiti.runtime.benchmark.chain import Chain
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.plan import BenchmarkPlan
from jiti.runtime.benchmark.playing import Game, Table
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.rollout.plan import label_of
from jiti.runtime.rollout.plan_file import TAU_FILE
from jiti.runtime.rollout.result import Choice, Rollout, write_tables
from jiti.runtime.rollout.tau import Calibration, save_calibration
from jiti.tasks.catalogue import load_catalogue

Outcomes = Mapping[int, tuple[bool, bool, int]]
"""By seed: success, elegance, interventions."""
DECISIONS = 10
FOUND = Calibration(0.5, 0.3, 0.281, 5, "", "", (), "jitter", "primitive", (), 600, (0, 1), 1, 10)


def rollout(task: str, label: str, seed: int, outcome: tuple[bool, bool, int]) -> Rollout:
    """101 states, 10 decisions of 3 ms each, the first of them interventions."""
    success, elegant, interventions = outcome
    choices = tuple(
        Choice(k, 10 * k, 0.0, 0.0, 0.0, k < interventions, (), 0, 0.001, 0.001, 0.001, "") for k in range(DECISIONS)
    )
    method, _, pick = label.partition("-")
    return Rollout(task, label, method, pick or "best", seed, success, elegant, False, 101, (), choices, 1.0, 2.0)


def write_rollouts(
    folder: Path, task: str, outcomes: Mapping[str, Outcomes], *, policy: str = "p", critic: str | None = None
) -> None:
    """`rollouts.parquet` of a group of cells, by label, of weights with these fingerprints."""
    folder.mkdir(parents=True, exist_ok=True)
    write_tables(
        folder,
        [rollout(task, label, seed, one) for label, many in outcomes.items() for seed, one in many.items()],
        {label: {"policy": policy, "critic": critic} for label in outcomes},
    )


def report(progress: Progress, what: str) -> None:
    """As something that takes a while does."""
    for share in (0.0, 0.5, 1.0):
        progress(share, what)


class Pretended:
    """Replaces what a chain does by what it would do, progress included: `done` names stages and games in their
    order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[str] = []
        monkeypatch.setattr(chain_module, "make_recordings", self._record)
        monkeypatch.setattr(chain_module, "make_labels", self._label)
        monkeypatch.setattr(chain_module, "make_dataset", self._curate)
        monkeypatch.setattr(chain_module, "train_all", self._train)
        monkeypatch.setattr(chain_module, "play_all", self._play)
        monkeypatch.setattr(Table, "find_tau", self._tau)

    def take(self) -> list[str]:
        """What was done since the last time."""
        taken, self.done = self.done, []
        return taken

    def _record(self, plan, folder: Path, *, progress: Progress, **_options) -> dict:
        self.done.append(f"record {plan.task.task_id}")
        report(progress, self.done[-1])
        return {"episodes": 4, "success": 4, "elegant": 2, "steps": 400}

    def _label(self, folder: Path, episodes: int, progress: Progress) -> dict:
        self.done.append(f"autolabel {folder.name}")
        report(progress, self.done[-1])
        (folder / "labels").mkdir()
        return {"episodes": episodes}

    def _curate(self, work: Work, stage: Stage, _plan, progress: Progress) -> dict:
        self.done.append(f"curate {stage.name}")
        report(progress, self.done[-1])
        work.folder(stage).mkdir(parents=True)
        return {"episodes": 4}

    def _train(self, work: Work, stages: Sequence[Stage], _plan, _workers, finished, progress: Progress) -> None:
        for place, stage in enumerate(stages):
            self.done.append(f"{stage.kind} {stage.name}")
            progress((place + 1) / len(stages), self.done[-1])
            work.folder(stage).mkdir(parents=True)
            finished(stage, 1.0, {"auc": 0.75, "episodes": 2})

    def _tau(self, stage: Stage) -> Calibration:
        self.done.append(f"tau {stage.name}")
        return FOUND

    def _play(self, games: Sequence[Game], _workers: int, progress: Progress) -> None:
        for place, game in enumerate(games):
            progress((place + 1) / len(games), f"playing {game.folder.name}")
            labels = game.plan.labels
            if game.plan.guidances[0].tau == float("inf"):
                save_calibration(game.folder.parent / TAU_FILE, FOUND)
                continue
            self.done.append(f"play {game.plan.task.task_id} {','.join(labels)}")
            for guidance in game.plan.guidances:
                (game.folder / label_of(guidance)).mkdir(parents=True, exist_ok=True)
                for number in range(game.episodes):
                    (game.folder / label_of(guidance) / f"{game.plan.stem(number)}.json").write_text("{}")
            seeds = range(game.plan.seed, game.plan.seed + game.episodes)
            outcomes = {label: {seed: (True, seed % 2 == 0, 3) for seed in seeds} for label in labels}
            write_rollouts(game.folder, game.plan.task.task_id, outcomes)


def chain_of(plan: BenchmarkPlan, out: Path, **options) -> Chain:
    """All of a plan, with one worker."""
    return Chain(Work(out), plan, load_catalogue(), plan.columns, plan.tasks, **options)
