"""What cells are played with: columns differ in their guidance alone, and start from the same states."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from jiti.errors import SourceError
from jiti.runtime.benchmark import chain as chain_module
from jiti.runtime.benchmark import playing
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column, DataPlan
from jiti.runtime.benchmark.plan_file import read_plan, shipped_plans
from jiti.runtime.benchmark.playing import guidance_of, kept_tau
from jiti.runtime.guidance import Guidance
from tests.builders.benchmark import FOUND, Pretended, chain_of

TAU = 0.2


def games(plan: BenchmarkPlan, folder) -> dict[str, list]:
    """By column, those of all tasks and training seeds, as a chain makes them."""
    chain = chain_of(plan, folder)
    found: dict[str, list] = {}
    for cell in chain.cells():
        found.setdefault(cell.column.name, []).append(chain.table.game(cell.stage, [cell.column], TAU))
    return found


def test_a_multiple_of_tau_reaches_the_guidance(tmp_path):
    plan = read_plan("g5")
    for name, played in games(plan, tmp_path).items():
        column = plan.column(name)
        for game in played:
            (guidance,) = game.plan.guidances
            wanted = TAU * column.tau_scale if column.method == "jiti" else None
            assert guidance.tau == (None if wanted is None else pytest.approx(wanted))
    assert len({column.tau_scale for column in plan.columns}) == 5


def test_the_calibrated_tau_is_what_is_multiplied(tmp_path, monkeypatch):
    columns = (Column("half", method="jiti", tau_scale=0.5), Column("ten", method="jiti", tau_scale=10.0))
    plan = BenchmarkPlan("two", "Two", DataPlan(("elegant/T2",)), columns)
    Pretended(monkeypatch)
    pretend = chain_module.play_all
    played: list[float | None] = []

    def play(games, workers, progress) -> None:
        played.extend(guidance.tau for game in games for guidance in game.plan.guidances)
        pretend(games, workers, progress)

    monkeypatch.setattr(chain_module, "play_all", play)
    chain_of(plan, tmp_path).run()
    calibrated = 0.5  # what a pretended calibration leaves
    assert played == [float("inf"), 0.5 * calibrated, 10 * calibrated]


@pytest.mark.parametrize("writable", [True, False])
def test_tau_is_kept_with_the_stage_and_with_the_critic_where_that_can_be_written(tmp_path, monkeypatch, writable):
    chain = chain_of(BenchmarkPlan("one", "One", DataPlan(("elegant/T2",)), (Column("a", method="jiti"),)), tmp_path)
    (cell,) = chain.cells()
    stage = cell.stage.needed("tau")
    critic = chain.work.folder(stage.needed("critics"))
    for folder in (critic, chain.work.folder(stage)):
        folder.mkdir(parents=True)
    monkeypatch.setattr(playing, "calibrate", lambda *_args, **_options: FOUND)
    monkeypatch.setattr(os, "access", lambda path, _mode: writable or Path(path) != critic)
    assert chain.table.find_tau(stage) == FOUND
    assert kept_tau(chain.work.folder(stage)) == FOUND.tau
    assert (critic / "tau.json").exists() == writable
    chain.table.find_tau(stage)  # again, where a run was killed before that was remembered
    assert kept_tau(chain.work.folder(stage)) == FOUND.tau
    (chain.work.folder(stage) / "tau.json").unlink()
    with pytest.raises(SourceError, match=r"has no tau that can be read\. Delete that folder"):
        kept_tau(chain.work.folder(stage))


@pytest.mark.parametrize(
    ("column", "wanted"),
    [
        (Column("a"), Guidance("none", candidates=3, window=2)),
        (Column("a", method="full"), Guidance("full", "best", 3, 2)),
        (Column("a", method="full", tau_scale=4.0), Guidance("full", "best", 3, 2)),
        (Column("a", method="jiti"), Guidance("jiti", "best", 3, 2, TAU)),
        (Column("a", method="jiti", pick="worst", tau_scale=4.0), Guidance("jiti", "worst", 3, 2, 4 * TAU)),
    ],
)
def test_a_column_is_guided_as_the_plan_says(column, wanted):
    plan = read_plan("table8")
    plan = replace(plan, rollouts=replace(plan.rollouts, candidates=3, window=2))
    assert guidance_of(column, plan, TAU) == wanted


@pytest.mark.parametrize("name", shipped_plans())
@pytest.mark.parametrize("tuning", [False, True])
def test_all_columns_start_from_the_same_states_and_may_take_as_long(tmp_path, name, tuning):
    plan = replace(read_plan(name), tuning=tuning)
    played = games(plan, tmp_path)
    assert set(played) == {column.name for column in plan.columns}
    starts = {
        column: {
            (
                game.plan.task.task_id,
                game.plan.seed,
                game.episodes,
                game.plan.start,
                game.plan.assets,
                game.plan.cameras,
                game.plan.most_steps,
                game.plan.device,
            )
            for game in own
        }
        for column, own in played.items()
    }
    first, *others = starts.values()
    assert all(other == first for other in others)
    assert {task for task, *_ in first} == set(plan.tasks)
    assert {start[1:3] for start in first} == {(plan.seed, plan.episodes)}
    assert {start[6] for start in first} == {plan.rollouts.most_steps}
    assert len(first) == len(plan.tasks)


def test_episodes_of_all_columns_have_the_same_seeds_and_names(tmp_path):
    plan = read_plan("table8")
    for own in games(plan, tmp_path).values():
        for game in own:
            names = [game.plan.stem(k).rpartition("_")[2] for k in range(3)]
            assert names == [str(plan.seed + k) for k in range(3)]
