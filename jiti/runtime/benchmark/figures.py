"""What a report's tables say, as numbers for scripts, and which rollouts they set beside each other."""

from dataclasses import replace
from typing import Any

from jiti.runtime.benchmark.cells import Paired, Results, effort, paired, rate
from jiti.runtime.benchmark.paper import FIGURES, paper_average
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column


def numbers(plan: BenchmarkPlan, results: Results) -> dict[str, Any]:
    """What the tables say, for scripts: null for what is missing."""
    columns: dict[str, Any] = {}
    for column in plan.columns:
        everything = results.of(column, plan.tasks)
        columns[column.name] = {
            "tasks": {task: _numbers(results.of(column, (task,))) for task in plan.tasks},
            "average": _numbers(everything),
            "groups": {group: _numbers(results.of(column, tasks)) for group, tasks in plan.groups.items()},
            "alike": _alike(plan, results, column),
            "paper": dict(FIGURES.get(column.paper, {})),
            "paper_average": paper_average(column.paper, plan.tasks),
        }
    comparisons = []
    for one in plan.comparisons:
        found = compared(plan, results, one.first, one.second, one.outcome)
        comparisons.append(
            {"first": one.first, "second": one.second, "outcome": one.outcome}
            | (
                {
                    "pairs": found.pairs,
                    "difference": found.difference,
                    "interval": list(found.interval),
                    "p": found.p,
                    "p_each": {str(seed): p for seed, p in found.p_each.items()},
                }
                if found
                else {"pairs": 0}
            )
        )
    missing = [{"column": column, "task": task, "training_seed": seed} for column, task, seed in results.missing()]
    return {"columns": columns, "comparisons": comparisons, "missing": missing}


def alike(plan: BenchmarkPlan, column: Column) -> Column | None:
    """A column on the training seeds that all columns have, to be compared with columns that have no more; None where
    it has no others, or all have none in common."""
    seeds = tuple(seed for seed in column.seeds if all(seed in other.seeds for other in plan.columns))
    if not seeds or seeds == column.seeds:
        return None
    named = f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))} only"
    return replace(column, title=f"{column.shown}, {named}", seeds=seeds, paper="")


def compared(plan: BenchmarkPlan, results: Results, first: str, second: str, outcome: str) -> Paired | None:
    """Two columns on all tasks and on the training seeds that both have; None where one of these cells is missing,
    or there are none."""
    columns = [plan.column(name) for name in (first, second)]
    seeds = [seed for seed in columns[0].seeds if seed in columns[1].seeds]
    sides: list[list[Any]] = [[], []]
    for task in plan.tasks:
        for seed in seeds:
            for side, column in zip(sides, columns, strict=True):
                cell = results.cells.get((column.name, task, seed))
                if cell is None:
                    return None
                side += cell
    return paired(sides[0], sides[1], outcome)


def _alike(plan: BenchmarkPlan, results: Results, column: Column) -> dict[str, Any] | None:
    """On the training seeds that all columns have, where a column has more."""
    if (part := alike(plan, column)) is None:
        return None
    return {
        "training_seeds": list(part.seeds),
        "tasks": {task: _numbers(results.of(part, (task,))) for task in plan.tasks},
        "average": _numbers(results.of(part, plan.tasks)),
    }


def _numbers(rollouts: Any) -> dict[str, Any] | None:
    if rollouts is None:
        return None
    told: dict[str, Any] = {"rollouts": len(rollouts)}
    for name in ("elegant", "success"):
        found = rate(rollouts, name)
        told[name] = {"rate": found.value, "interval": list(found.interval)}
    cost = effort(rollouts)
    told |= {"interventions": cost.interventions, "intervention_rate": cost.share}
    return told | {"decision_ms": cost.decision_ms}
