"""A training that fails says why, and one that is stopped leaves no process."""

import os
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from jiti.errors import UsageError
from jiti.runtime.benchmark import training
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column, DataPlan
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.benchmark.training import critic_job, policy_job, train_all
from jiti.runtime.benchmark.values import better_half
from tests.builders.benchmark import chain_of

PLAN = BenchmarkPlan(
    "one", "One", DataPlan(("elegant/T2",)), (Column("end", method="jiti", rewards="sparse", data="weighted"),)
)


def stages(tmp_path):
    chain = chain_of(PLAN, tmp_path)
    return chain.work, chain.stages.policy("weighted", 3), chain.stages.critic("sparse")


def test_jobs_say_what_the_plan_says(tmp_path):
    work, policy, critic = stages(tmp_path)
    arguments = policy_job(work, policy, PLAN)["arguments"]
    weights = work.folder(policy.needed("values")).absolute() / "progress.parquet"
    weighted = {"--sample_weighting.type=rabc", f"--sample_weighting.progress_path={weights}"}
    assert {"--seed=3", "--steps=30000", *weighted} <= set(arguments)
    assert any(one.startswith("--output_dir=") and one.endswith(".partial") for one in arguments)
    job = critic_job(work, critic, PLAN)
    assert job["settings"] == {"run": {"steps": 6000, "seed": 0}, "data": {"rewards": "success"}}
    assert job["recipe"] == "state"


def pretend(monkeypatch, codes: dict[str, str]) -> list[Stage]:
    """Trainings that have ended before they are looked at, with what each kind's process ran, told where its result
    goes; which of them were begun."""
    begun: list[Stage] = []

    def start(work, stage, _plan):
        folder = work.folder(stage)
        folder.parent.mkdir(parents=True, exist_ok=True)
        log = folder.with_name(f"{folder.name}.log")
        (folder.parent / f".{folder.name}.partial").mkdir()
        begun.append(stage)
        result = folder.with_name(f"{folder.name}.result.json")
        process = subprocess.Popen([sys.executable, "-c", codes[stage.kind], str(result)])
        process.wait(60)
        return training._Running(stage, process, log, log.open("wb"))

    monkeypatch.setattr(training, "_start", start)
    return begun


def test_a_training_that_is_done_is_kept_where_another_failed_before_it(tmp_path, monkeypatch):
    work, policy, critic = stages(tmp_path)
    pretend(monkeypatch, {"critics": "raise SystemExit(3)", "policies": ""})
    finished: list[str] = []
    with pytest.raises(UsageError, match="training critic sparse failed: it said nothing and ended with 3"):
        train_all(work, [critic, policy], PLAN, 2, lambda stage, *_: finished.append(stage.name), lambda *_: None)
    assert finished == ["weighted-3"]
    assert work.folder(policy).is_dir()


def test_a_training_that_was_killed_is_told_from_one_that_failed(tmp_path, monkeypatch):
    work, policy, _ = stages(tmp_path)
    pretend(monkeypatch, {"policies": "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"})
    with pytest.raises(UsageError, match=r"policy weighted-3 was ended from outside \(SIGKILL\).*fewer --workers"):
        train_all(work, [policy], PLAN, 1, lambda *_: None, lambda *_: None)
    assert not work.folder(policy).exists()


def test_what_needs_a_critic_waits_for_it(tmp_path, monkeypatch):
    """However many may work at once."""
    work, policy, _ = stages(tmp_path)
    values = policy.needed("values")
    alone = chain_of(PLAN, tmp_path).stages.policy("all", 0)
    result = "import sys, pathlib; p = pathlib.Path(sys.argv[1]); p.write_text('{}')"
    begun = pretend(monkeypatch, {"critics": result, "values": result, "policies": ""})
    todo = [policy, values, alone, values.needed("critics")]
    train_all(work, todo, PLAN, 4, lambda *_: None, lambda *_: None)
    assert [stage.name for stage in begun] == ["all-0", "segments", "segments", "weighted-3"]
    assert [stage.kind for stage in begun] == ["policies", "critics", "values", "policies"]


@pytest.mark.parametrize("count", [1, 2, 5, 6])
def test_the_better_half_of_each_task_is_kept(count):
    random = np.random.default_rng(count)
    tasks = list(random.permutation(["a"] * count + ["b"] * (count + 1)))
    values = list(random.normal(size=len(tasks)))
    kept = better_half(tasks, values)
    for task, many in (("a", count), ("b", count + 1)):
        inside = [values[place] for place in kept if tasks[place] == task]
        outside = [value for place, value in enumerate(values) if place not in kept and tasks[place] == task]
        assert len(inside) == (many + 1) // 2
        assert not outside or min(inside) > max(outside)
    assert kept == sorted(kept)


@pytest.mark.slow
def test_a_training_that_fails_says_why_and_where_the_rest_is(tmp_path):
    pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
    work, _, critic = stages(tmp_path)
    finished: list[str] = []
    with pytest.raises(UsageError, match=r"training critic sparse failed: .*no LeRobot dataset.*\.log"):
        train_all(work, [critic], PLAN, 1, lambda stage, *_: finished.append(stage.name), lambda *_: None)
    assert finished == []
    assert work.done(critic) is None


@pytest.mark.slow
def test_a_training_ends_with_the_process_that_asked_for_it(tmp_path):
    code = (
        "import subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import os, time; from jiti.runtime.benchmark.trainer import "
        "end_with; end_with(os.getppid()); time.sleep(60)'], start_new_session=True)\n"
        "print(child.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    asking = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=os.environ)
    assert asking.stdout is not None
    child = psutil.Process(int(asking.stdout.readline()))
    time.sleep(5)
    asking.kill()
    asking.wait()
    asking.stdout.close()
    child.wait(20)
