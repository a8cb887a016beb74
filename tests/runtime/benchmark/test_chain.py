"""What is finished is not done again; what depends on a changed input is."""

import re
import shutil
from dataclasses import replace

import pytest

from jiti.errors import UsageError
from jiti.runtime.benchmark import about, kept
from jiti.runtime.benchmark import chain as chain_module
from jiti.runtime.benchmark.command import report, run_chain
from jiti.runtime.benchmark.make import recordings_plan
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column, CriticPlan, DataPlan, PolicyPlan, RolloutsPlan
from jiti.runtime.benchmark.plan_file import read_plan
from jiti.runtime.benchmark.stages import in_order
from jiti.tasks.catalogue import Catalogue, load_catalogue
from tests.builders.benchmark import Pretended, chain_of

PLAN = BenchmarkPlan(
    "small",
    "A small one",
    DataPlan(("elegant/T0", "elegant/T2"), episodes=4),
    (
        Column("base", method="none", seeds=(0, 1)),
        Column("jiti", method="jiti"),
        Column("random", method="jiti", pick="random"),
        Column("filtered", method="none", data="filtered"),
    ),
    policy=PolicyPlan(steps=10),
    critic=CriticPlan(steps=10),
    rollouts=RolloutsPlan(episodes=3, tuning_episodes=2),
)
ALL = [
    "record elegant/T0",
    "record elegant/T2",
    "autolabel elegant-T0",
    "autolabel elegant-T2",
    "curate all",
    "critics segments",
    "values segments",
    "policies all-0",
    "policies all-1",
    "policies filtered-0",
    "tau all-0-segments",
    "play elegant/T0 none",
    "play elegant/T0 none",
    "play elegant/T2 none",
    "play elegant/T2 none",
    "play elegant/T0 jiti,jiti-random",
    "play elegant/T2 jiti,jiti-random",
    "play elegant/T0 none",
    "play elegant/T2 none",
]


@pytest.fixture
def pretended(monkeypatch) -> Pretended:
    return Pretended(monkeypatch)


def test_everything_is_done_once(pretended, tmp_path):
    chain_of(PLAN, tmp_path).run()
    assert pretended.take() == ALL
    chain_of(PLAN, tmp_path).run()
    assert pretended.take() == []
    assert chain_of(PLAN, tmp_path).results().missing() == []


@pytest.mark.parametrize(
    ("plan", "again"),
    [
        (
            replace(PLAN, critic=CriticPlan(steps=11)),
            ["critics segments", "values", "policies filtered-0", "tau", "play"],
        ),
        (replace(PLAN, policy=PolicyPlan(steps=11)), ["policies", "tau", "play"]),
        (replace(PLAN, data=replace(PLAN.data, quality=0.4)), ["record", "autolabel", "curate", "critics", "tau"]),
        (replace(PLAN, rollouts=replace(PLAN.rollouts, episodes=4)), ["play"]),
        (replace(PLAN, tuning=True), ["play"]),
        (replace(PLAN, rollouts=replace(PLAN.rollouts, timing=True)), ["play"]),
        (replace(PLAN, columns=(Column("x2", method="jiti", tau_scale=2.0),)), ["play"]),
        (
            replace(PLAN, columns=(Column("sparse", method="jiti", rewards="sparse"),)),
            ["critics sparse", "tau", "play"],
        ),
    ],
)
def test_a_changed_input_redoes_what_depends_on_it_and_nothing_else(pretended, tmp_path, plan, again):
    chain_of(PLAN, tmp_path).run()
    pretended.take()
    chain_of(plan, tmp_path).run()
    done = pretended.take()
    assert done
    for wanted in again:
        assert any(one.startswith(wanted) for one in done), wanted
    kinds = {one.split(" ")[0] for one in done}
    if "record" not in again:
        assert not kinds & {"record", "autolabel", "curate"}
    if again == ["play"]:
        assert kinds == {"play"}
    if again[0] == "critics segments":
        assert done.count("play elegant/T0 none") == 1, "of the policy on what the critic kept"
    chain_of(PLAN, tmp_path).run()
    assert pretended.take() == [], "what was there before is still there"


def test_times_are_of_rollouts_that_were_played_for_them(tmp_path):
    eight, timed = (read_plan(name) for name in ("table8", "g6"))
    assert timed.rollouts.timing
    before, after = (
        {(stage.kind, stage.key) for stage in in_order(cell.stage for cell in chain_of(plan, tmp_path).cells())}
        for plan in (eight, timed)
    )
    assert {kind for kind, _ in after - before} == {"rollouts"}
    assert {kind for kind, _ in after & before} == {"record", "autolabel", "curate", "policies", "critics", "tau"}


def test_pushes_are_a_matter_of_the_recordings_and_without_them_nothing_has_another_name(tmp_path):
    pushed = replace(PLAN, data=replace(PLAN.data, disturbance=0.3))
    calm, other = (chain_of(plan, tmp_path).stages.recordings("elegant/T2") for plan in (PLAN, pushed))
    assert "disturbance" not in calm.inputs
    assert calm.key != other.key
    assert recordings_plan(pushed, load_catalogue().task("elegant/T2"), None).disturbance == 0.3


def test_another_scene_or_asset_pack_of_the_same_name_makes_everything_anew(pretended, tmp_path):
    packs = [tmp_path / name / "assets" for name in ("one", "other")]
    for place, pack in enumerate(packs):
        (pack / "scenes").mkdir(parents=True)
        (pack / "scenes" / "table.xml").write_bytes(b"x" * place)
    chain = chain_of(PLAN, tmp_path / "work")
    moved = tuple(
        replace(task, bddl="libero_goal/push_the_plate_to_the_front_of_the_stove")
        if task.task_id == "elegant/T2"
        else task
        for task in chain.catalogue
    )
    chains = [replace(chain, assets=str(pack)) for pack in packs] + [replace(chain, catalogue=Catalogue(moved))]
    keys = [{stage.key for stage in in_order(cell.stage for cell in one.cells())} for one in (chain, *chains)]
    assert not set.intersection(keys[0], keys[1])
    assert not set.intersection(keys[1], keys[2])
    names = {stage.name for stage in in_order(c.stage for c in chain.cells()) if stage.key in keys[0] & keys[3]}
    assert names == {"elegant-T0"}, "recordings and labels of the task that is the same"


def test_what_people_decide_makes_another_dataset(pretended, tmp_path):
    chain = chain_of(PLAN, tmp_path)
    chain.run()
    pretended.take()
    own = chain.work.folder(chain.stages.labels("elegant/T2")) / "segments" / "annotator=ada"
    own.mkdir(parents=True)
    (own / "elegant-T2_0000.parquet").write_bytes(b"a label")
    chain_of(PLAN, tmp_path).run()
    done = pretended.take()
    assert done == [one for one in ALL if one.split(" ")[0] not in ("record", "autolabel")]
    (own / "episode.parquet").write_bytes(b"a label of a recording that is not learned from")
    chain_of(PLAN, tmp_path).run()
    assert pretended.take() == []


def test_parts_can_be_done_alone_and_what_they_need_is_said(pretended, tmp_path):
    with pytest.raises(UsageError, match=r"--only policies needs what curate makes.*--only curate"):
        chain_of(PLAN, tmp_path).run(only=("policies",))
    chain_of(PLAN, tmp_path).run(only=("record", "autolabel"))
    assert pretended.take() == ALL[:4]
    (base, *_) = PLAN.columns
    part = replace(chain_of(PLAN, tmp_path), columns=(base,), tasks=("elegant/T2",))
    part.run()
    expected = ["curate all", "policies all-0", "policies all-1", *["play elegant/T2 none"] * 2]
    assert pretended.take() == expected
    results = part.results()
    assert set(results.cells) == {("base", "elegant/T2", 0), ("base", "elegant/T2", 1)}
    assert len(results.missing("base")) == 2
    chain_of(PLAN, tmp_path).run()
    done = pretended.take()
    assert not {"curate all", "policies all-0", "policies all-1"} & set(done)
    assert done.count("play elegant/T2 none") == 1, "of the filtered policy"


def test_a_finished_cell_does_not_need_the_policy_that_played_it(pretended, tmp_path):
    chain_of(PLAN, tmp_path).run()
    pretended.take()
    shutil.rmtree(tmp_path / "policies")
    chain_of(PLAN, tmp_path).run()
    assert pretended.take() == []


def test_rollouts_whose_table_was_not_written_are_gone_through_again(pretended, tmp_path):
    chain_of(PLAN, tmp_path).run()
    pretended.take()
    (one, *_) = sorted((tmp_path / "rollouts").glob("elegant-T0-filtered-*/rollouts.parquet"))
    one.unlink()
    assert chain_of(PLAN, tmp_path).results().missing() == [("filtered", "elegant/T0", 0)]
    chain_of(PLAN, tmp_path).run()
    assert pretended.take() == ["play elegant/T0 none"]
    assert chain_of(PLAN, tmp_path).results().missing() == []


def test_progress_only_grows_and_tells_the_time_that_is_left(pretended, tmp_path):
    told = []
    chain = chain_of(PLAN, tmp_path)
    chain.run(progress=lambda share, what: told.append((share, what)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert shares[-1] == pytest.approx(1)
    assert all(re.fullmatch(r".+; about \d.* left", what) for _, what in told)
    kinds = list(dict.fromkeys(what.split(" ")[0] for _, what in told))
    assert kinds == ["record", "autolabel", "curate", "critics", "values", "policies", "playing"]


def test_the_report_says_what_ran_and_what_is_missing(pretended, tmp_path):
    told: list[str] = []
    chain = replace(chain_of(PLAN, tmp_path), tasks=("elegant/T0",), say=told.append)
    run_chain(chain, (), lambda _share, _what: None)
    done = report(chain, tmp_path / "report")
    assert {(one["column"], one["task"]) for one in done.content["missing"]} == {
        (column.name, "elegant/T2") for column in PLAN.columns
    }
    text = (tmp_path / "report" / "report.md").read_text()
    assert "Missing: base on elegant/T2 (seed 0)" in text
    assert about.plan_digest(PLAN) in text
    assert "1 finished" in text
    assert "tau of all-0-segments is 0.5: 28.1% of 10 decisions exceed it, 30.0% were asked for" in told
    assert "| all-0-segments | 0.5 | 30.0% | 28.1% | 10 | 1 |" in text
    assert "missing" in str(done)
    assert str(tmp_path) not in text


def test_the_report_says_what_code_made_what_it_is_of(pretended, tmp_path, monkeypatch):
    def run(plan: BenchmarkPlan, revision: str, torch: str) -> dict[str, str]:
        monkeypatch.setattr(kept, "code", lambda: (revision, {"python": "3.12", "torch": torch}))
        chain = chain_of(plan, tmp_path)
        run_chain(chain, (), lambda _share, _what: None)
        return dict(about.made_rows(chain, chain.results()))

    def made(rows: dict[str, str]) -> tuple[str, str]:
        return rows["revisions that made it"], rows["versions that made it"]

    assert made(run(PLAN, "one", "2.7")) == ("one", "python 3.12, torch 2.7")
    assert made(run(PLAN, "two", "2.8")) == ("one", "python 3.12, torch 2.7"), "it made nothing"
    more = replace(PLAN, name="more", rollouts=replace(PLAN.rollouts, episodes=4))
    assert made(run(more, "three", "2.8")) == ("one, three", "python 3.12, torch 2.7 and 2.8")
    assert made(run(PLAN, "four", "2.8"))[0] == "one, three", "they share the folders of rollouts"
    timed = replace(PLAN, name="timed", rollouts=replace(PLAN.rollouts, timing=True))
    assert made(run(timed, "five", "2.8"))[0] == "one, five", "it shares what was trained"


def test_a_run_that_is_killed_is_said_with_what_it_played(pretended, tmp_path, monkeypatch):
    """What is killed does not come to its end: here it does not say so."""

    def run(revision: str) -> dict[str, str]:
        monkeypatch.setattr(kept, "code", lambda: (revision, {"python": "3.12"}))
        chain = chain_of(PLAN, tmp_path)
        run_chain(chain, (), lambda _share, _what: None)
        return rows(chain)

    def rows(chain) -> dict[str, str]:
        return dict(about.made_rows(chain, chain.results()))

    with monkeypatch.context() as killed:
        killed.setattr(kept.Work, "end_run", lambda *_: None)
        told = run("one")
    assert told["revisions that made it"] == "one"
    assert told["wall time"].endswith("in 1 run (1 running or killed)")
    shutil.rmtree(next((tmp_path / "rollouts").glob("elegant-T0-all-0-segments-*/jiti")))
    told = run("two")
    assert told["revisions that made it"] == "one, two"
    assert told["wall time"].endswith("in 2 runs (1 killed, 1 finished)")
    first, second = chain_of(PLAN, tmp_path).work.runs()
    assert len(first["played"]) == 8
    assert len(second["played"]) == 1


def test_a_run_in_which_nothing_was_played_played_nothing(pretended, tmp_path, monkeypatch):
    seen: list[str] = []

    def fail(games, *_options):
        for game in games:
            game.folder.mkdir(parents=True, exist_ok=True)
        seen.extend(run["ended"] for run in chain_of(PLAN, tmp_path).work.runs())
        raise UsageError("nothing can be played")

    monkeypatch.setattr(chain_module, "play_all", fail)
    columns = (replace(PLAN.columns[0], seeds=(0,)),)
    with pytest.raises(UsageError, match="nothing can be played"):
        run_chain(chain_of(replace(PLAN, columns=columns), tmp_path), (), lambda _share, _what: None)
    (run,) = chain_of(PLAN, tmp_path).work.runs()
    assert seen == ["running"]
    assert (run["ended"], run["played"]) == ("stopped", [])


def test_time_and_digests_are_of_the_runs_that_are_reported(pretended, tmp_path):
    tuned, longer = replace(PLAN, tuning=True), replace(PLAN, policy=PolicyPlan(steps=11))
    for plan in (tuned, PLAN, longer, replace(PLAN, quick=True)):
        run_chain(chain_of(plan, tmp_path), (), lambda _share, _what: None)
    assert about.plan_digest(tuned) == about.plan_digest(PLAN) != about.plan_digest(longer)
    chain = chain_of(PLAN, tmp_path)
    rows = dict(about.made_rows(chain, chain.results()))
    assert rows["wall time"].endswith("in 1 run (1 finished)")
    assert rows["other digests of this plan that ran here"] == about.plan_digest(longer)
    tuning = chain_of(tuned, tmp_path)
    rows = dict(about.made_rows(tuning, tuning.results()))
    assert rows["wall time"].endswith("in 1 run (1 finished)")
    assert "other digests of this plan that ran here" not in rows
    assert [(run["tuning"], run["quick"]) for run in chain.work.runs()] == [
        (True, False),
        (False, False),
        (False, False),
        (False, True),
    ]
