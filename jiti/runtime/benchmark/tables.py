"""The paper's tables with our columns: a report as blocks of text, tables and charts, which `page` writes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jiti.runtime.benchmark.cells import Estimate, Results, effort, rate
from jiti.runtime.benchmark.charts import Bar, Point, bar_chart, sweep_chart
from jiti.runtime.benchmark.figures import alike, compared, numbers
from jiti.runtime.benchmark.paper import DECISION_MS, FIGURES, INTERVENTIONS, RATE, is_over, paper_average
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column

MISSING = "missing"
"""In the place of a cell that was not played, or not to its end."""
NOTHING = "–"


@dataclass(frozen=True, slots=True)
class TextTable:
    """Rows of texts; the first column names them."""

    heading: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Chart:
    """An SVG."""

    name: str
    """Of its file."""
    svg: str


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what is under it: paragraphs, tables, charts."""

    title: str
    parts: tuple[str | TextTable | Chart, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """All of it, and the numbers behind it for scripts."""

    title: str
    lead: tuple[str, ...]
    sections: tuple[Section, ...]
    numbers: Mapping[str, Any] = field(default_factory=dict)


def make_report(
    plan: BenchmarkPlan, results: Results, made: Sequence[tuple[str, str]], stages: Sequence[Section]
) -> Report:
    """The report of what is there. `made` is how, as names and values; `stages` are sections on data and training."""
    sections = [
        Section("Averages", tuple(_averages(plan, results))),
        Section("Elegant success rate", tuple(_by_task(plan, results))),
    ]
    if plan.groups:
        sections.append(Section("Groups of tasks", tuple(_groups(plan, results))))
    if plan.comparisons:
        sections.append(Section("Paired tests", tuple(_comparisons(plan, results))))
    sections.append(Section("Success rate", (_rates(plan, results, "success"),)))
    if (sweep := _sweep(plan, results)) is not None:
        sections.append(Section("Multiples of tau (G.5)", sweep))
    sections += stages
    sections.append(Section("How it was made", (TextTable(("", ""), tuple(made)),)))
    return Report(plan.title, tuple(_lead(plan, results)), tuple(sections), numbers(plan, results))


def shown_rate(found: Estimate | None) -> str:
    """`62.0 (48–74)`, in percent with the 95% interval."""
    return MISSING if found is None else in_percent(found.value, *found.interval)


def in_percent(value: float, low: float, high: float) -> str:
    """A share and its interval, for people."""
    return f"{100 * value:.1f} ({100 * low:.0f}–{100 * high:.0f})"


def _lead(plan: BenchmarkPlan, results: Results) -> Iterator[str]:
    if plan.quick:
        yield "Made small with --quick: it proves nothing but that it runs."
    if plan.tuning:
        yield "Played from the tuning seeds, on which choices may be made: these are not the figures to report."
    if plan.note:
        yield plan.note
    whole = len(results.wanted) - len(results.missing())
    yield (
        f"{results.episodes} rollouts a cell, a cell being a column on a task with one trained policy; {whole} of "
        f"{len(results.wanted)} cells are whole. Rates are in percent, with 95% intervals in parentheses: by "
        "Wilson for one training seed; for several by a bootstrap over initial states within tasks, in which the "
        "policies of a state stay together. How much policies differ is in none of them. Elegant is success with every "
        "implicit task constraint satisfied; ESR is its rate. The paper's figures are of SmolVLA with pictures on "
        "demonstrations by people, ours of the plan's own policy on scripted ones: compare the differences, not the "
        "levels."
    )
    if any(alike(plan, column) for column in plan.columns):
        yield (
            "Columns have different numbers of training seeds: compare one that has several with one that has fewer by "
            "its row of the seeds that all of them have. Paired tests take the seeds that both have."
        )
    if gone := results.missing():
        names = [f"{column} on {task} (seed {seed})" for column, task, seed in gone[:6]]
        more = f" and {len(gone) - 6} more" if len(gone) > 6 else ""
        yield f"Missing: {', '.join(names)}{more}. Averages over a missing cell are missing too."


def _by_task(plan: BenchmarkPlan, results: Results) -> Iterator[TextTable | Chart]:
    yield _rates(plan, results, "elegant", paper=True)
    bars = []
    for task in plan.tasks:
        for column in plan.columns:
            own = results.of(column, (task,))
            bars.append(Bar(_short(task), column.shown, rate(own) if own else None, _paper(column, task)))
    yield Chart("esr-by-task", bar_chart(bars))


def _rows(plan: BenchmarkPlan) -> Iterator[Column]:
    """Every column, and after one of more training seeds than others have, the same on theirs."""
    for column in plan.columns:
        yield column
        if (part := alike(plan, column)) is not None:
            yield part


def _rates(plan: BenchmarkPlan, results: Results, outcome: str, *, paper: bool = False) -> TextTable:
    rows = []
    for column in _rows(plan):
        cells = [shown_rate(_rate(results, column, (task,), outcome)) for task in plan.tasks]
        rows.append((column.shown, *cells, shown_rate(_rate(results, column, plan.tasks, outcome))))
        if paper and column.paper:
            figures = [_paper_text(column, task) for task in plan.tasks]
            rows.append((f"{column.shown}, paper", *figures, _percent(paper_average(column.paper, plan.tasks))))
    return TextTable(("", *(_short(task) for task in plan.tasks), "average"), tuple(rows))


def _averages(plan: BenchmarkPlan, results: Results) -> Iterator[str | TextTable | Chart]:
    rows = []
    bars = []
    for column in _rows(plan):
        own = results.of(column, plan.tasks)
        cost = effort(own) if own else None
        paper = paper_average(column.paper, plan.tasks)
        if column in plan.columns:
            bars.append(Bar("", column.shown, rate(own) if own else None, None if paper is None else paper / 100))
        guided = column.method != "none"
        rows.append(
            (
                column.shown,
                shown_rate(rate(own) if own else None),
                _percent(paper),
                shown_rate(rate(own, "success") if own else None),
                (f"{cost.interventions:.2f}" if guided else NOTHING) if cost else MISSING,
                _paper_cost(column, INTERVENTIONS, plan.tasks),
                (f"{100 * cost.share:.1f}%" if guided else NOTHING) if cost else MISSING,
                _paper_cost(column, RATE, plan.tasks, "%"),
                f"{cost.decision_ms:.2f}" if cost else MISSING,
                _paper_cost(column, DECISION_MS, plan.tasks),
                str(len(own)) if own else MISSING,
                ", ".join(map(str, column.seeds)),
            )
        )
    heading = ("", "ESR", "paper", "success", "interventions an episode", "paper")
    heading += ("of decisions", "paper", "ms a decision", "paper", "rollouts", "training seeds")
    yield TextTable(heading, tuple(rows))
    yield Chart("esr-average", bar_chart(bars))
    if problems := {
        c.shown: sum(one.problems for one in own) for c in plan.columns if (own := results.of(c, plan.tasks))
    }:
        told = [f"{name}: {count}" for name, count in problems.items() if count]
        if told:
            yield f"Decisions at which the critic gave no number, and the default was executed: {', '.join(told)}."
    yield (
        "Times are of policy and critic on this machine's processor, as many episodes at once as there were workers; "
        "G.6 has them on a GPU. They compare columns, not machines."
    )


def _groups(plan: BenchmarkPlan, results: Results) -> Iterator[TextTable]:
    rows = []
    for group, tasks in plan.groups.items():
        for column in _rows(plan):
            cells = (shown_rate(_rate(results, column, tasks, outcome)) for outcome in ("elegant", "success"))
            rows.append((f"{group}: {column.shown}", *cells, str(len(tasks))))
    yield TextTable(("", "ESR", "success", "tasks"), tuple(rows))


def _comparisons(plan: BenchmarkPlan, results: Results) -> Iterator[str | TextTable]:
    rows = []
    for one in plan.comparisons:
        names = f"{plan.column(one.first).shown} → {plan.column(one.second).shown}"
        what = "ESR" if one.outcome == "elegant" else "success"
        found = compared(plan, results, one.first, one.second, one.outcome)
        if found is None:
            rows.append((names, what, *[MISSING] * 6))
            continue
        low, high = found.interval
        each = ", ".join(f"{p:.2g}" for p in found.p_each.values())
        difference = f"{100 * found.difference:+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"
        rows.append(
            (
                names,
                what,
                str(found.pairs),
                difference,
                str(found.only_first),
                str(found.only_second),
                f"{found.p:.2g}",
                each,
            )
        )
    yield (
        "Of whole cells that both have, with the same policy and the same initial state. Difference in points with a "
        "95% bootstrap over states within tasks. p is of an exact sign-flip test, two-sided, in which the policies of "
        "a state stay together: each state counts once. Beside it, exact McNemar for each training seed alone."
    )
    heading = ("", "of", "pairs", "difference", "only the first", "only the second", "p", "p of each seed")
    yield TextTable(heading, tuple(rows))


def _sweep(plan: BenchmarkPlan, results: Results) -> tuple[str | Chart, ...] | None:
    """Where columns differ in the multiple of tau alone."""
    scaled = [c for c in plan.columns if c.method == "jiti" and c.pick == "best" and c.data == "all"]
    scaled = [c for c in scaled if c.rewards == "segments"]
    if len({c.tau_scale for c in scaled}) < 3:
        return None
    points = []
    for column in sorted(scaled, key=lambda c: c.tau_scale):
        own = results.of(column, plan.tasks)
        share = effort(own).share if own else None
        paper = paper_average(column.paper, plan.tasks)
        beside = None if paper is None else paper / 100
        points.append(Point(column.tau_scale, rate(own) if own else None, beside, share))
    return (
        "Average ESR over multiples of the calibrated tau, and the share of decisions that exceeded it.",
        Chart("tau", sweep_chart(points)),
    )


def _rate(results: Results, column: Column, tasks: Sequence[str], outcome: str) -> Estimate | None:
    own = results.of(column, tasks)
    return rate(own, outcome) if own else None


def _paper(column: Column, key: str) -> float | None:
    """As a share."""
    value = FIGURES.get(column.paper, {}).get(key)
    return None if value is None else value / 100


def _paper_text(column: Column, key: str, unit: str = "") -> str:
    return _percent(FIGURES.get(column.paper, {}).get(key), unit)


def _paper_cost(column: Column, key: str, tasks: Sequence[str], unit: str = "") -> str:
    """Nothing beside other tasks than the paper's, for these are averages."""
    return _paper_text(column, key, unit) if is_over(column.paper, tasks) else NOTHING


def _percent(value: float | None, unit: str = "") -> str:
    return NOTHING if value is None else f"{value:g}{unit}"


def _short(task: str) -> str:
    return task.removeprefix("elegant/")
