"""How many rollouts a guidance turned to elegant ones, and how many it spoiled, for each task of a plan.

    uv run python benchmarks/turned.py table8 benchmarks/results/table8

Columns of one policy begin in the same states, and draw the same default chunks as long as they execute the same. What
comes out otherwise than the base was turned by a chunk that was chosen. A random pick turns few where it matters little
what is drawn at triggers; JITI spoils as many as it mends where the critic does not rank what it may choose from.
FOLDER is a work folder of `jiti benchmark`, or what is kept of one in benchmarks/results.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from jiti.errors import JitiError
from jiti.runtime.benchmark.cells import Results, paired
from jiti.runtime.benchmark.chain import Chain
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.plan import BenchmarkPlan
from jiti.runtime.benchmark.plan_file import read_plan
from jiti.tasks.catalogue import load_catalogue


@dataclass(frozen=True, slots=True)
class Turned:
    """A column beside the base on a task, on the training seeds that both have."""

    task: str
    column: str
    rollouts: int
    mended: int
    """Elegant, where the base was not."""
    spoiled: int
    """Not elegant, where the base was."""


def turned(plan: BenchmarkPlan, results: Results) -> Iterator[Turned]:
    """Every guided column with the base's data, on every task where both were played."""
    base = next(column for column in plan.columns if column.method == "none")
    for task in plan.tasks:
        for column in plan.columns:
            if column.method == "none" or column.data != base.data:
                continue
            before, after = results.of(base, (task,)), results.of(column, (task,))
            if before and after and (found := paired(before, after)):
                yield Turned(task, column.name, found.pairs, found.only_second, found.only_first)


def table_of(found: list[Turned]) -> Table:
    """A row for each task, mended and spoiled of each column in percent."""
    columns = list(dict.fromkeys(one.column for one in found))
    by_place = {(one.task, one.column): one for one in found}
    table = Table(title="+ mended, - spoiled, percent", title_justify="left")
    for name in ("task", *columns):
        table.add_column(name, justify="left" if name == "task" else "right")
    for task in dict.fromkeys(one.task for one in found):
        table.add_row(task, *(_shown(by_place.get((task, column))) for column in columns))
    return table


def _shown(one: Turned | None) -> str:
    if one is None:
        return "missing"
    return f"+{100 * one.mended / one.rollouts:.0f} -{100 * one.spoiled / one.rollouts:.0f} of {one.rollouts}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", metavar="PLAN", help="table8, or a TOML file, as of `jiti benchmark`")
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    parser.add_argument("--assets", help="the pack that it was played with, if not the plan's")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here as well")
    asked = parser.parse_args()
    try:
        catalogue = load_catalogue()
        plan = read_plan(asked.plan, catalogue)
        chain = Chain(Work(asked.folder), plan, catalogue, plan.columns, plan.tasks, asked.assets)
        found = list(turned(plan, chain.results()))
    except JitiError as error:
        sys.exit(str(error))
    if not found:
        sys.exit(f"{asked.folder} has no whole cells of the plan {plan.name} beside its base (--assets?).")
    Console().print(table_of(found))
    if asked.json:
        asked.json.write_text(json.dumps([asdict(one) for one in found], indent=2) + "\n")


if __name__ == "__main__":
    main()
