"""Critics, what they think of the demonstrations, and base policies: each by a process of one thread, as many at once
as there are cores."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from jiti.durable import make_folder
from jiti.errors import UsageError
from jiti.policies.recipe import recipe_path
from jiti.progress import Progress
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.plan import BenchmarkPlan
from jiti.runtime.benchmark.stages import Kind, Stage
from jiti.runtime.benchmark.values import KEPT, WEIGHTS

POLL_S = 0.5
TRAINED: tuple[Kind, ...] = ("critics", "values", "policies")
"""What is made here, in the order in which it is begun."""
_TAIL = 4000
_STEP = re.compile(r"step:(\d+(?:\.\d+)?)([KM]?)")
_SHARE = re.compile(r"share:(\d\.\d+)")
Finished = Callable[[Stage, float, Mapping[str, Any]], None]
"""Told of a stage that is done, the seconds that it took, and what it came to."""


def policy_job(work: Work, stage: Stage, plan: BenchmarkPlan) -> dict[str, Any]:
    """lerobot-train, on the recipe. It writes beside its place, which it takes when it is done."""
    steps = stage.inputs["steps"]
    arguments = [
        "--policy.discover_packages_path=jiti.policies",
        f"--config_path={recipe_path(stage.inputs['recipe'])}",
        f"--dataset.root={work.folder(stage.needs[0]).absolute()}",
        f"--output_dir={_partial(work, stage).absolute()}",
        f"--seed={stage.inputs['seed']}",
        f"--steps={steps}",
        f"--save_freq={steps}",
        f"--log_freq={max(1, min(100, steps // 20))}",
    ]
    if stage.inputs["data"] == "filtered":
        kept = (work.folder(stage.needed("values")) / KEPT).read_text()
        arguments.append(f"--dataset.episodes={kept}")
    elif stage.inputs["data"] == "weighted":
        weights = (work.folder(stage.needed("values")) / WEIGHTS).absolute()
        arguments += ["--sample_weighting.type=rabc", f"--sample_weighting.progress_path={weights}"]
    return {"kind": stage.kind, "arguments": arguments}


def critic_job(work: Work, stage: Stage, plan: BenchmarkPlan) -> dict[str, Any]:
    """`jiti train-critic`, on the recipe and the plan's settings; it goes on where it was stopped."""
    settings = {section: dict(keys) for section, keys in stage.inputs["settings"].items()}
    settings["run"] = {**settings.get("run", {}), "steps": stage.inputs["steps"], "seed": stage.inputs["seed"]}
    if stage.inputs["rewards"] == "sparse":
        settings["data"] = {**settings.get("data", {}), "rewards": "success"}
    out = work.folder(stage).absolute()
    return {
        "kind": stage.kind,
        "recipe": plan.critic.recipe,
        "settings": settings,
        "dataset": str(work.folder(stage.needs[0]).absolute()),
        "out": str(out),
        "features": str((work.out / "features").absolute()),
        "result": str(out.with_name(f"{out.name}.result.json")),
    }


def values_job(work: Work, stage: Stage, plan: BenchmarkPlan) -> dict[str, Any]:
    """`jiti.runtime.benchmark.values`."""
    out = work.folder(stage).absolute()
    return {
        "kind": stage.kind,
        "critic": str(work.folder(stage.needed("critics")).absolute()),
        "dataset": str(work.folder(stage.needed("curate")).absolute()),
        "out": str(out),
        "features": str((work.out / "features").absolute()),
        "result": str(out.with_name(f"{out.name}.result.json")),
    }


_SPOKEN = {"critics": "critic", "values": "values by critic", "policies": "policy"}
_JOBS: Mapping[str, Callable[[Work, Stage, BenchmarkPlan], dict[str, Any]]] = {
    "critics": critic_job,
    "values": values_job,
    "policies": policy_job,
}


def steps(stage: Stage) -> float:
    """What it costs, in a policy's steps: a critic's take half as long, and to value demonstrations some seconds."""
    return stage.inputs.get("steps", 400) * (1 if stage.kind == "policies" else 0.5)


@dataclass
class _Running:
    stage: Stage
    process: subprocess.Popen[bytes]
    log: Path
    file: IO[bytes]
    began: float = field(default_factory=time.monotonic)

    def share(self) -> float:
        """By what it said last."""
        text = _end(self.log)
        if self.stage.kind == "policies":
            found = _STEP.findall(text)
            scale = {"": 1, "K": 1e3, "M": 1e6}
            return float(found[-1][0]) * scale[found[-1][1]] / self.stage.inputs["steps"] if found else 0.0
        shares = _SHARE.findall(text)
        return float(shares[-1]) if shares else 0.0


def train_all(
    work: Work, stages: Sequence[Stage], plan: BenchmarkPlan, workers: int, finished: Finished, progress: Progress
) -> None:
    """Train these, each when what it needs of them is done. Those that are done are kept whatever becomes of the
    others; a policy that was stopped begins anew.

    Raises UsageError with the end of the log of one that failed, or with the signal that ended one; the others are then
    stopped.
    """
    waiting, running, ended = list(stages), [], 0.0
    costs = {stage.key: steps(stage) for stage in stages}
    total = sum(costs.values())
    try:
        while waiting or running:
            undone = {stage.key for stage in [*waiting, *(one.stage for one in running)]}
            ready = [stage for stage in waiting if not undone & {needed.key for needed in stage.needs}]
            for stage in ready[: workers - len(running)]:
                waiting.remove(stage)
                running.append(_start(work, stage, plan))
            time.sleep(POLL_S)
            failed: list[UsageError] = []
            for one in [one for one in running if one.process.poll() is not None]:
                running.remove(one)
                try:
                    made = _ended(work, one)
                except UsageError as error:
                    failed.append(error)
                    continue
                finished(one.stage, time.monotonic() - one.began, made)
                ended += costs[one.stage.key]
            if failed:
                raise failed[0]
            share = ended + sum(one.share() * costs[one.stage.key] for one in running)
            progress(share / max(1, total), f"training {', '.join(_title(one.stage) for one in running) or 'done'}")
    finally:
        for one in running:
            one.process.terminate()
        for one in running:
            try:
                one.process.wait(10)
            except subprocess.TimeoutExpired:
                one.process.kill()
                one.process.wait()
            one.file.close()


def _start(work: Work, stage: Stage, plan: BenchmarkPlan) -> _Running:
    folder = work.folder(stage)
    make_folder(folder.parent)
    job = _JOBS[stage.kind](work, stage, plan)
    if stage.kind == "policies":
        for place in (folder, _partial(work, stage)):
            if place.exists():
                shutil.rmtree(place)
    path, log = (folder.with_name(f"{folder.name}{suffix}") for suffix in (".job.json", ".log"))
    path.write_text(json.dumps({**job, "parent": os.getpid()}, indent=1))
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    if plan.policy.recipe == "state_flow":  # which begins from nothing: lerobot would ask the Hub all the same
        environment.setdefault("HF_HUB_OFFLINE", "1")
    file = log.open("wb")
    command = [sys.executable, "-m", "jiti.runtime.benchmark.trainer", str(path.absolute())]
    # Ctrl-C reaches every process of a terminal; this one ends them itself.
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, env=environment, start_new_session=True
    )
    return _Running(stage, process, log, file)


def _ended(work: Work, one: _Running) -> dict[str, Any]:
    one.file.close()
    if one.process.returncode < 0:
        name = signal.Signals(-one.process.returncode).name
        raise UsageError(
            f"training {_title(one.stage)} was ended from outside ({name}), perhaps for want of memory. What is "
            f"finished is kept: run the same command again, with fewer --workers. All that it said is in {one.log}."
        )
    if one.process.returncode:
        said = [line for line in _end(one.log).splitlines() if line.strip()]
        last = said[-1].removeprefix("jiti: ") if said else f"it said nothing and ended with {one.process.returncode}"
        raise UsageError(f"training {_title(one.stage)} failed: {last} All that it said is in {one.log}.")
    folder = work.folder(one.stage)
    if one.stage.kind == "policies":
        _partial(work, one.stage).rename(folder)
        return {"steps": one.stage.inputs["steps"]}
    result = folder.with_name(f"{folder.name}.result.json")
    made = json.loads(result.read_text())
    result.unlink()
    return made


def _partial(work: Work, stage: Stage) -> Path:
    folder = work.folder(stage)
    return folder.with_name(f".{folder.name}.partial")


def _title(stage: Stage) -> str:
    return f"{_SPOKEN[stage.kind]} {stage.name}"


def _end(log: Path) -> str:
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - _TAIL))
        return file.read().decode(errors="replace")
