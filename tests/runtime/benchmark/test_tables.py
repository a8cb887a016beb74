"""Tables of rollouts that nobody played, against what is worked out by hand."""

import math
import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from jiti.errors import SourceError
from jiti.runtime.benchmark.cells import Cell, One, Results, effort, paired, rate, read_cells, sign_flip
from jiti.runtime.benchmark.figures import alike, numbers
from jiti.runtime.benchmark.page import to_html, to_markdown, write_report
from jiti.runtime.benchmark.paper import paper_average
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column, Comparison, DataPlan, RolloutsPlan
from jiti.runtime.benchmark.plan_file import read_plan
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.benchmark.tables import MISSING, Chart, TextTable, make_report
from jiti.runtime.rollout.summary import bootstrap_interval, mcnemar
from tests.builders.benchmark import write_rollouts

T0, T2 = "elegant/T0", "elegant/T2"
BASE, JITI = (
    Column("base", "Base", seeds=(0, 1), paper="base"),
    Column("jiti", "JITI", "jiti", seeds=(0,), paper="jiti"),
)
PLAN = BenchmarkPlan(
    "two",
    "Two columns",
    DataPlan((T0, T2)),
    (BASE, JITI),
    rollouts=RolloutsPlan(episodes=4, seed=100),
    comparisons=(Comparison("base", "jiti"), Comparison("base", "jiti", "success")),
    groups={"rest": (T2,)},
)
WON, CLUMSY, LOST = (True, True), (True, False), (False, False)
HALF = [WON, LOST, WON, LOST, LOST, WON]
PLAYED = {
    ("base", T0, 0): [WON, CLUMSY, CLUMSY, LOST],
    ("base", T2, 0): [CLUMSY, CLUMSY, LOST, LOST],
    ("base", T0, 1): [WON, WON, CLUMSY, CLUMSY],
    ("base", T2, 1): [LOST, LOST, LOST, LOST],
    ("jiti", T0, 0): [WON, WON, WON, CLUMSY],
    ("jiti", T2, 0): [CLUMSY, WON, WON, LOST],
}


def results(folder: Path, played=PLAYED, episodes: int = 4) -> Results:
    """As they are read from `rollouts.parquet`; JITI intervenes 3 times an episode."""
    cells, folders = [], {}
    for (name, task, seed), outcomes in played.items():
        column = PLAN.column(name)
        stage = Stage("rollouts", f"{name}-{task[-2:]}-{seed}", {"cell": [name, task, seed]})
        label = column.method
        rows = {100 + k: (*one, 3 if label == "jiti" else 0) for k, one in enumerate(outcomes)}
        write_rollouts(folder / stage.folder, task, {label: rows, "other": {100: (True, True, 0)}})
        cells.append(Cell(column, task, seed, stage, label))
        folders[stage.key] = folder / stage.folder
    found = read_cells(cells, folders, first=100, episodes=episodes)
    wanted = [(c.name, task, seed) for c in PLAN.columns for task in PLAN.tasks for seed in c.seeds]
    return replace(found, wanted=wanted)


def test_rates_and_effort_are_those_of_the_rollouts(tmp_path):
    found = results(tmp_path)
    base, jiti = (found.of(column, PLAN.tasks) for column in PLAN.columns)
    assert base is not None
    assert jiti is not None
    assert (rate(base).count, rate(base).of) == (3, 16)
    assert (rate(base, "success").count, rate(base, "success").of) == (9, 16)
    assert (rate(jiti).count, rate(jiti).of) == (5, 8)
    cost = effort(jiti)
    assert (cost.interventions, cost.share) == (3.0, 0.3)
    assert cost.decision_ms == pytest.approx(3.0)


def test_pairs_are_of_one_policy_and_one_state(tmp_path):
    found = results(tmp_path)
    base, jiti = (found.of(column, PLAN.tasks) for column in PLAN.columns)
    assert base is not None
    assert jiti is not None
    pair = paired(base, jiti)
    assert pair is not None
    # Training seed 0 alone is shared: on T0 two states and on T2 two states are won by JITI only.
    assert (pair.pairs, pair.only_first, pair.only_second) == (8, 0, 4)
    assert pair.difference == 0.5
    assert pair.p == pytest.approx(2 / 2**4)
    assert pair.p_each == {0: pair.p}
    assert 0.0 < pair.interval[0] < 0.5 < pair.interval[1] <= 1.0
    assert paired(base, []) is None


@pytest.mark.parametrize(
    ("first", "second", "p"),
    [(0, 0, 1.0), (1, 1, 1.0), (0, 5, 2 / 32), (2, 8, 2 * (1 + 10 + 45) / 1024), (8, 2, 2 * (1 + 10 + 45) / 1024)],
)
def test_mcnemar_is_the_exact_binomial(first, second, p):
    assert mcnemar(first, second) == pytest.approx(p)


@pytest.mark.parametrize("sums", [[], [0, 0], [1], [3, -1, 2, 2, 0, -3, 1], [1] * 6 + [-1] * 3, [-2, -2, -1]])
def test_the_sign_flip_test_is_all_signs_gone_through(sums):
    signs = product((1, -1), repeat=len(sums))
    totals = [sum(sign * value for sign, value in zip(one, sums, strict=True)) for one in signs]
    p = sum(abs(total) >= abs(sum(sums)) for total in totals) / len(totals)
    assert sign_flip(sums) == pytest.approx(p)
    if {abs(value) for value in sums} <= {0, 1}:
        assert sign_flip(sums) == pytest.approx(mcnemar(sums.count(-1), sums.count(1)))


def test_interval_and_p_keep_the_policies_of_one_state_together(tmp_path):
    """Three policies that agree on every state tell no more than one of them."""
    first, second = ([one for seed in range(3) for one in played(states, seed)] for states in ([LOST] * 6, HALF))
    three = paired(first, second)
    one = paired([r for r in first if r.training == 0], [r for r in second if r.training == 0])
    assert three is not None
    assert one is not None
    assert three.interval == one.interval
    assert three.p == one.p == three.p_each[0]


def played(states, training: int = 0, task: str = T0) -> list[One]:
    return [One(task, training, k, won, elegant, 10, 0, 0, 0.1, 1.0) for k, (won, elegant) in enumerate(states)]


def test_policies_that_agree_make_no_rate_more_certain():
    assert rate(played(HALF)).interval == pytest.approx(_wilson(3, 6))
    one = np.array([elegant for _, elegant in HALF], float)
    pooled = [rate([rollout for training in range(count) for rollout in played(HALF, training)]) for count in (2, 3)]
    assert [found.of for found in pooled] == [12, 18]
    for found in pooled:
        assert found.interval == pytest.approx(bootstrap_interval(one, [T0] * 6))
        assert found.interval[0] < _wilson(9, 18)[0]


@pytest.mark.parametrize("outcomes", [(LOST, LOST), (WON, WON), (WON, LOST)])
def test_where_no_state_differs_each_counts_once(outcomes):
    found = rate([one for training in range(2) for one in played([outcomes[training]] * 6, training)])
    assert (found.count, found.of) == (6 * outcomes.count(WON), 12)
    assert found.interval == pytest.approx(_wilson(3 * outcomes.count(WON), 6))


def test_a_cell_that_is_not_whole_is_missing_everywhere(tmp_path):
    played = {**PLAYED, ("jiti", T2, 0): PLAYED["jiti", T2, 0][:3]}
    found = results(tmp_path, played)
    assert found.missing() == [("jiti", T2, 0)]
    told = numbers(PLAN, found)
    assert told["columns"]["jiti"]["average"] is None
    assert told["columns"]["jiti"]["tasks"][T2] is None
    assert told["columns"]["jiti"]["tasks"][T0]["elegant"]["rate"] == 0.75
    assert told["comparisons"][0]["pairs"] == 0
    report = make_report(PLAN, found, (), ())
    (row,) = [row for row in _table(report, "Elegant success rate").rows if row[0] == "JITI"]
    assert row == ("JITI", "75.0 (30–95)", MISSING, MISSING)
    assert "Missing: jiti on elegant/T2 (seed 0)" in to_markdown(report)
    assert found.of(JITI, (T0,)) is not None


def test_more_rollouts_than_asked_for_are_not_counted(tmp_path):
    found = results(tmp_path, episodes=2)
    assert found.missing() == []
    assert numbers(PLAN, found)["columns"]["jiti"]["average"]["rollouts"] == 4


def test_the_tables_have_the_papers_figures_beside_ours(tmp_path):
    report = make_report(PLAN, results(tmp_path), [("plan", "two")], ())
    # Of Base's two policies: on T2 no state differs from another.
    states = np.array([[1, 0.5, 0, 0], [0, 0, 0, 0]])
    low, high = (100 * x for x in bootstrap_interval(states.ravel(), [T0] * 4 + [T2] * 4))
    one_low, one_high = (100 * x for x in bootstrap_interval(states[0], [T0] * 4))
    assert _table(report, "Elegant success rate").rows == (
        ("Base", f"37.5 ({one_low:.0f}–{one_high:.0f})", "0.0 (0–49)", f"18.8 ({low:.0f}–{high:.0f})"),
        ("Base, paper", "70", "34", "52"),
        ("Base, seed 0 only", "25.0 (5–70)", "0.0 (0–49)", "12.5 (2–47)"),
        ("JITI", "75.0 (30–95)", "50.0 (15–85)", "62.5 (31–86)"),
        ("JITI, paper", "86", "42", "64"),
    )
    averages = {row[0]: row[1:] for row in _table(report, "Averages").rows}
    # The paper's interventions and times are averages over all eight tasks.
    assert averages["JITI"][1:9] == ("64", "87.5 (53–98)", "3.00", "–", "30.0%", "–", "3.00", "–")
    assert averages["Base"][3:6] == ("–", "–", "–")
    assert averages["Base, seed 0 only"][:2] == ("12.5 (2–47)", "–")
    assert averages["Base, seed 0 only"][-2:] == ("8", "0")
    assert not any(name.startswith("JITI,") for name in averages)
    told = report.numbers["columns"]
    assert told["jiti"]["alike"] is None
    assert told["base"]["alike"]["training_seeds"] == [0]
    assert told["base"]["alike"]["average"]["elegant"]["rate"] == 1 / 8
    assert _table(report, "Groups of tasks").rows[2] == ("rest: JITI", "50.0 (15–85)", "75.0 (30–95)", "1")
    tests = _table(report, "Paired tests").rows
    assert tests[0][:2] == ("Base → JITI", "ESR")
    assert tests[0][2] == "8"
    assert tests[0][4:] == ("0", "4", "0.12", "0.12")
    assert tests[1][1] == "success"
    (esr, _) = report.numbers["comparisons"]
    assert (esr["p"], esr["p_each"]) == (0.125, {"0": 0.125})


def test_a_column_is_set_beside_others_on_the_seeds_of_all():
    plan = read_plan("table8")
    parts = {column.name: part.seeds for column in plan.columns if (part := alike(plan, column))}
    assert parts == {"base": (0,), "jiti": (0,), "random": (0,)}
    apart = replace(PLAN, columns=(BASE, replace(JITI, seeds=(2,))))
    assert [alike(apart, column) for column in apart.columns] == [None, None]


@pytest.mark.parametrize("name", ["table8", "libero"])
def test_every_column_of_a_large_plan_is_compared(name):
    plan = read_plan(name)
    compared = {one for pair in plan.comparisons for one in (pair.first, pair.second)}
    assert compared == {column.name for column in plan.columns}


def test_the_papers_average_is_over_the_same_tasks():
    eight = tuple(f"elegant/T{k}" for k in range(8))
    assert paper_average("base", eight) == 49.8
    assert paper_average("base", (T0, T2)) == 52
    assert paper_average("base", ("rq3/seen-A",)) is None
    assert paper_average("base", (*eight, "rq3/seen-A")) is None
    seven = read_plan("rq3").tasks
    assert [paper_average(row, seven) for row in ("rq3-base", "rq3-jiti")] == [53.0, 68.6]
    for row, own in (
        ("rq3-base", seven),
        ("tau-1", eight),
        ("full", eight),
        ("rigid-jiti", read_plan("g4-rigid").tasks),
    ):
        assert paper_average(row, own) is not None
        assert paper_average(row, (*own, "own/task")) is None
    for row, some in (("rq3-base", ("rq3/seen-A",)), ("tau-1", (T2,)), ("full", (T2,)), ("sparse", seven)):
        assert paper_average(row, some) is None
    assert paper_average("", eight) is None


def test_the_papers_interventions_stand_beside_its_eight_tasks():
    plan = read_plan("table8")
    rows = {row[0]: row for row in _table(make_report(plan, Results({}, (), 50), [], ()), "Averages").rows}
    assert [rows["JITI"][place] for place in (5, 7, 9)] == ["6.26", "33.9%", "220.5"]


def test_a_sweep_of_tau_is_drawn_where_there_is_one(tmp_path):
    assert not any("Multiples" in section.title for section in make_report(PLAN, results(tmp_path), (), ()).sections)
    scales = tuple(Column(f"x{k}", method="jiti", tau_scale=scale) for k, scale in enumerate((0.5, 1.0, 2.0)))
    plan = replace(PLAN, columns=scales, comparisons=(), groups={})
    report = make_report(plan, Results({}, [], 4), (), ())
    (section,) = [section for section in report.sections if section.title.startswith("Multiples")]
    assert any(isinstance(part, Chart) and part.svg.count("missing") == 3 for part in section.parts)


def test_the_page_needs_nothing_else(tmp_path):
    report = make_report(replace(PLAN, title="A <b> title"), results(tmp_path), [("plan", "<script>")], ())
    html = to_html(report)
    assert not re.search(r"https?:|<script|<link|<img|src=|url\(|@import", html)
    assert "A &lt;b&gt; title" in html
    assert "&lt;script&gt;" in html
    assert html.count("<svg") == 2
    path = write_report(tmp_path / "report", report)
    assert path.read_text() == html
    for plot in re.findall(r"\]\((plots/\S+)\)", (tmp_path / "report" / "report.md").read_text()):
        assert (tmp_path / "report" / plot).read_text().startswith("<svg xmlns=")


def test_a_table_that_cannot_be_read_is_named(tmp_path):
    results(tmp_path)
    (path,) = tmp_path.glob("base-T0-0-*/rollouts.parquet")
    path.write_bytes(b"no table")
    cell = Cell(BASE, T0, 0, Stage("rollouts", "base-T0-0", {}), "none")
    with pytest.raises(SourceError, match=r"rollouts.parquet cannot be read"):
        read_cells([cell], {cell.stage.key: path.parent}, first=100, episodes=4)
    write_rollouts(path.parent, T0, {"none": {100: (True, True, 0)}})
    twice = pq.read_table(path)
    pq.write_table(twice.take([0, 0]), path)
    with pytest.raises(SourceError, match="seed 100 twice"):
        read_cells([cell], {cell.stage.key: path.parent}, first=100, episodes=4)


def test_cells_of_a_policy_that_was_trained_again_are_not_set_beside_each_other(tmp_path):
    policy, critic = Stage("policies", "all-0", {}), Stage("critics", "segments", {})
    alone, guided = Stage("rollouts", "T0-none", {}, (policy,)), Stage("rollouts", "T0-jiti", {}, (policy, critic))
    cells = [Cell(BASE, T0, 0, alone, "none"), Cell(JITI, T0, 0, guided, "jiti")]
    folders = {stage.key: tmp_path / stage.folder for stage in (alone, guided)}

    def write(stage: Stage, label: str, weights: str, seed: int = 100) -> None:
        outcomes = {label: {seed: (True, True, 0)}, "other": {100: (True, True, 0)}}
        write_rollouts(folders[stage.key], T0, outcomes, policy=weights, critic=None if stage is alone else "c")

    def read() -> Results:
        return read_cells(cells, folders, first=100, episodes=1)

    write(alone, "none", "old")
    assert len(read().cells) == 1
    write(guided, "jiti", "new")
    said = rf"{policy.folder} was trained again.*old in \S*/T0-none-.*; new in \S*/T0-jiti-.*Delete the folders"
    with pytest.raises(SourceError, match=said):
        read()
    write(guided, "jiti", "new", seed=101)
    assert len(read().cells) == 1, "what is not counted does not matter"
    write(guided, "jiti", "old")
    assert read().missing() == []


def _table(report, title: str) -> TextTable:
    (section,) = [section for section in report.sections if section.title == title]
    (table,) = [part for part in section.parts if isinstance(part, TextTable)]
    return table


def _wilson(count: int, of: int) -> tuple[float, float]:
    z = 1.959963984540054
    rate, share = count / of, z * z / of
    half = z * math.sqrt(rate * (1 - rate) / of + share / of / 4)
    return (rate + share / 2 - half) / (1 + share), (rate + share / 2 + half) / (1 + share)
