"""Intervals against scipy, pairs against counts by hand, and what the numbers of an episode add up to."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from jiti.errors import UsageError
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.report import Report
from jiti.runtime.rollout.result import Choice, Rollout, load_result, save_result, write_tables
from jiti.runtime.rollout.summary import bootstrap_interval, compare, compare_all, summarize, wilson
from jiti.tasks.judge import Verdict

NAN = float("nan")


def choice(number: int, *, triggered: bool = False, chosen: int = 0, problem: str = "") -> Choice:
    return Choice(number, 10 * number, 1.0, NAN, NAN, triggered, (), chosen, 0.001, 0.002, 0.003, problem)


def rollout(
    label: str, seed: int, elegant: bool, choices=(), task: str = "elegant/T2", success: bool = True
) -> Rollout:
    verdicts = (("elegant/T2/centered", Verdict(elegant, 20, "as it was")),)
    method, _, pick = label.partition("-")
    row = (task, label, method, pick or "best", seed, success, elegant, False, 31)
    return Rollout(*row, verdicts, tuple(choices), 0.9, 1.0)


def outcomes(label: str, elegant, **more) -> list[Rollout]:
    return [rollout(label, seed, bool(one), **more) for seed, one in enumerate(elegant)]


@given(st.integers(0, 200), st.integers(0, 200))
def test_an_interval_is_scipys_wilson(some, more):
    count, of = some, some + more
    if not of:
        assert wilson(count, of) == (0.0, 1.0)
        return
    expected = binomtest(count, of).proportion_ci(0.95, "wilson")
    assert wilson(count, of) == pytest.approx((expected.low, expected.high), abs=1e-9)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_pairs_are_counted_and_tested_whichever_is_named_first(pairs):
    a, b = outcomes("none", [p[0] for p in pairs]), outcomes("jiti", [p[1] for p in pairs])
    there, back = compare(a, b, draws=200), compare(b, a, draws=200)
    assert there.both + there.only_first + there.only_second + there.neither == there.pairs == len(pairs)
    assert (there.only_first, there.only_second) == (back.only_second, back.only_first)
    assert there.p == pytest.approx(back.p)
    assert there.difference == -back.difference
    assert there.difference == pytest.approx((there.only_second - there.only_first) / len(pairs))
    low, high = there.interval
    assert low - 1e-9 <= there.difference <= high + 1e-9 or len(pairs) < 4


def test_a_known_table_has_its_exact_p():
    # 10 pairs differ, 9 of them one way: 2 (C(10, 0) + C(10, 1)) / 2^10.
    a = outcomes("none", [1] + [0] * 9 + [1] * 5)
    b = outcomes("jiti", [0] + [1] * 9 + [1] * 5)
    found = compare(a, b)
    assert (found.both, found.only_first, found.only_second, found.neither) == (5, 1, 9, 0)
    assert found.p == pytest.approx(22 / 1024)
    assert found.difference == pytest.approx(8 / 15)
    assert found == compare(a, b)
    assert compare(a, a).p == 1.0


def test_only_states_that_both_have_played_are_paired():
    a, b = outcomes("none", [1, 0, 1, 0]), outcomes("jiti", [1, 1])
    assert compare(a, b).pairs == 2
    other_task = [replace(r, task="elegant/T0") for r in b]
    with pytest.raises(UsageError, match="no initial state in common"):
        compare(a, other_task)
    with pytest.raises(UsageError, match="twice"):
        compare([*a, a[0]], b)
    (pair,) = compare_all([*a, *b])
    assert (pair.first, pair.second) == ("none", "jiti")


def test_a_bootstrap_covers_a_mean_as_often_as_it_says_and_keeps_groups_apart():
    random = np.random.default_rng(3)
    hits = 0
    for trial in range(300):
        values = random.normal(0.2, 1.0, 60)
        low, high = bootstrap_interval(values, ["T0"] * 60, draws=400, seed=trial)
        hits += low <= 0.2 <= high
    assert 0.90 <= hits / 300 <= 0.98
    # Within each group all is the same, so nothing varies.
    values = np.array([1.0] * 10 + [0.0] * 30)
    assert bootstrap_interval(values, ["T0"] * 10 + ["T1"] * 30) == (0.25, 0.25)
    low, high = bootstrap_interval(values, ["T0"] * 40)
    assert low < 0.25 < high


def test_decisions_and_times_add_up():
    choices = [
        choice(0),
        choice(1, triggered=True, chosen=3),
        choice(2, triggered=True),
        choice(3, problem="no number"),
    ]
    plain = [rollout("none", s, s == 0, [choice(k) for k in range(3)], success=s < 2) for s in range(4)]
    guided = [rollout("jiti", s, True, choices) for s in range(4)]
    none, jiti = summarize([*plain, *guided])
    assert (none.label, none.elegant.value, none.success.value, none.interventions) == ("none", 0.25, 0.5, 0)
    assert (jiti.interventions, jiti.triggered.value, jiti.changed.value, jiti.problems) == (2.0, 0.5, 0.25, 4)
    assert jiti.decision_ms == pytest.approx(6.0)
    assert jiti.step_ms == pytest.approx(4 * 6.0 / 30)
    assert jiti.sim_ms == pytest.approx(30.0)


def test_a_result_comes_back_as_it_was_and_tables_have_null_for_no_number(tmp_path):
    import pyarrow.parquet as pq

    one = rollout("jiti-random", 3, False, [choice(0), choice(1, triggered=True, chosen=2)])
    path = tmp_path / "one.json"
    save_result(path, one)
    assert "NaN" not in path.read_text()
    assert repr(load_result(path)) == repr(one)
    write_tables(tmp_path, [one])
    row = pq.read_table(tmp_path / "rollouts.parquet").to_pylist()[0]
    assert (row["method"], row["pick"], row["decisions"], row["interventions"]) == ("jiti", "random", 2, 1)
    assert row["itcs"][0] == {"itc": "elegant/T2/centered", "satisfied": False, "step": 20, "reason": "as it was"}
    assert pq.read_table(tmp_path / "decisions.parquet")["q_bar"].null_count == 2


def test_a_report_is_a_table_for_people_and_json_for_scripts(tmp_path, capsys):
    rollouts = [*outcomes("none", [0, 0, 1, 0]), *outcomes("jiti", [1, 0, 1, 1])]
    report = Report(tmp_path, "elegant/T2", rollouts, {"policy": "p", "tau": 0.1})
    report.print()
    told = capsys.readouterr().out
    assert "none, jiti" in told
    assert "+50" in told
    assert "0.75 (0.30 to 0.95)" in told
    content = json.loads(report.to_json())
    assert [m["elegant"]["count"] for m in content["methods"]] == [1, 3]
    assert content["methods"][0]["triggered"]["rate"] is None
    assert content["pairings"][0]["only_second"] == 2
    assert content["tau"] == 0.1


def test_labels_are_methods_and_picks():
    from jiti.runtime.rollout.plan import label_of, parse_guidance

    assert parse_guidance("jiti", "random") == ("jiti", "random")
    assert parse_guidance("none", "random") == ("none", "best")
    assert parse_guidance("full:worst") == ("full", "worst")
    assert label_of(Guidance("full", "worst")) == "full-worst"
    with pytest.raises(UsageError, match="--guidance jit: there are none, jiti, full"):
        parse_guidance("jit")
    with pytest.raises(UsageError, match="--pick top: there are best"):
        parse_guidance("jiti:top")
