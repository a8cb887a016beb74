"""`jiti benchmark`, whole: from what a user asked for to what is printed."""

import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import Any

from jiti.annotate.engine import cores
from jiti.durable import make_folder
from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.progress import Progress
from jiti.runtime.benchmark.about import made_rows, plan_digest, stage_sections
from jiti.runtime.benchmark.chain import Chain, Say
from jiti.runtime.benchmark.figures import numbers
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.page import write_report
from jiti.runtime.benchmark.plan import BenchmarkPlan, smaller
from jiti.runtime.benchmark.plan_file import read_plan
from jiti.runtime.benchmark.remaining import duration
from jiti.runtime.benchmark.stages import KINDS, REPORT
from jiti.runtime.benchmark.tables import MISSING, in_percent, make_report
from jiti.runtime.rollout.run import make_out
from jiti.runtime.workers import alone
from jiti.tasks.catalogue import Catalogue, load_catalogue

FOLDER = Path("benchmark")
NEEDS = {"lerobot": "learn", "robosuite": "sim", "torch": "learn"}
"""Packages, and the extra that brings each."""


@dataclass(frozen=True)
class Request:
    """The command's arguments."""

    plan: str = "table8"
    out: Path = FOLDER
    only: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    tasks: tuple[str, ...] = ()
    task_files: tuple[Path, ...] = ()
    episodes: int | None = None
    assets: str | None = None
    workers: int | None = None
    tuning: bool = False
    quick: bool = False


@dataclass(frozen=True)
class Done:
    """What to print."""

    page: Path
    plan: BenchmarkPlan
    content: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        columns = self.content["columns"]
        lines = [
            f"{self.plan.title}: ESR over {len(self.plan.tasks)} task{'s' if len(self.plan.tasks) > 1 else ''}, "
            "in percent with 95% intervals"
        ]
        width = max(len(column.shown) for column in self.plan.columns)
        for column in self.plan.columns:
            average = columns[column.name]["average"]
            esr, success = ((_shown(average, name)) for name in ("elegant", "success"))
            paper = columns[column.name]["paper_average"]
            beside = f"   paper {paper:g}" if paper is not None else ""
            lines.append(f"  {column.shown:<{width}}  {esr:>18}   success {success}{beside}")
        if missing := self.content["missing"]:
            lines.append(f"{len(missing)} cells are missing.")
        if self.plan.quick:
            lines.append("Made with --quick: it shows that it runs, and the figures mean nothing.")
        return "\n".join([*lines, f"All tables: {self.page}"])

    def to_json(self) -> str:
        return json.dumps({"report": str(self.page), "plan": self.plan.name, **self.content}, indent=2)


def _shown(average: dict[str, Any] | None, name: str) -> str:
    return MISSING if average is None else in_percent(average[name]["rate"], *average[name]["interval"])


def resolved(request: Request, catalogue: Catalogue) -> BenchmarkPlan:
    """The plan that a request is about. Raises UsageError."""
    plan = read_plan(request.plan, catalogue)
    if request.quick:
        plan = smaller(plan, next(iter(_tasks(request, plan, catalogue)), None))
    if request.episodes is not None:
        rollouts = replace(plan.rollouts, episodes=request.episodes, tuning_episodes=request.episodes)
        plan = replace(plan, rollouts=rollouts)
    return replace(plan, tuning=request.tuning)


def _tasks(request: Request, plan: BenchmarkPlan, catalogue: Catalogue) -> tuple[str, ...]:
    """Those of --tasks. Raises UsageError for one that the plan does not play."""
    tasks = tuple(catalogue.simulated(name).task_id for name in request.tasks)
    if unknown := [task for task in tasks if task not in plan.tasks]:
        raise UsageError(f"--tasks {unknown[0]}: the plan plays {', '.join(plan.tasks)}.")
    return tasks


def run_request(request: Request, progress: Progress, say: Say) -> Done:
    """Do what is missing, and write the report of what is there. Raises JitiError; what is finished is kept."""
    catalogue = load_catalogue(*request.task_files)
    plan = resolved(request, catalogue)
    _check(request)
    columns = tuple(plan.column(name) for name in request.columns) or plan.columns
    tasks = plan.tasks if request.quick else _tasks(request, plan, catalogue) or plan.tasks
    if request.quick and len(request.tasks) > 1:
        say(f"--quick plays one task, {plan.tasks[0]}")
    workers = request.workers or cores()
    chain = Chain(Work(request.out), plan, catalogue, columns, tasks, request.assets, workers, say=say)
    run_chain(chain, tuple(kind for kind in request.only if kind != REPORT), progress, skip=request.only == (REPORT,))
    return report(chain, request.out / report_name(plan))


def run_chain(chain: Chain, only: Sequence[str], progress: Progress, *, skip: bool = False) -> None:
    """Run a chain alone in its folder, and remember that it ran."""
    if skip:
        return
    make_out(chain.work.out)
    marks = chain.work.out / "stages"  # and not the folder itself, which `jiti record` keeps for itself in a demo
    make_folder(marks)
    from jiti.runtime.rollout.plan_file import hardware

    with alone(marks, "jiti benchmark"):
        began, ended = monotonic(), "stopped"
        chain.work.begin_run(
            {
                "plan": chain.plan.name,
                "digest": plan_digest(chain.plan),
                "tuning": chain.plan.tuning,
                "quick": chain.plan.quick,
                "workers": chain.workers,
                "machine": hardware(),
            }
        )
        try:
            chain.run(only, progress)
            ended = "finished"
        finally:
            chain.work.end_run({"ended": ended, "wall_s": round(monotonic() - began, 1)})
        chain.say(f"All of it took {duration(monotonic() - began)} now.")


def report(chain: Chain, folder: Path) -> Done:
    """Write the report of what is there, whole or not."""
    results = chain.results()
    page = write_report(folder, make_report(chain.plan, results, made_rows(chain, results), stage_sections(chain)))
    return Done(page, chain.plan, numbers(chain.plan, results))


def report_name(plan: BenchmarkPlan) -> str:
    """Its folder in the work folder: several plans may share one."""
    return f"{plan.name}{'-quick' if plan.quick else ''}{'-tuning' if plan.tuning else ''}"


def _check(request: Request) -> None:
    """Raises UsageError before anything is made for what would stop it later."""
    for name in request.only:
        if name not in (*KINDS, REPORT):
            raise UsageError(f"--only {name}: {nearest(name, (*KINDS, REPORT))}.")
    check_installed()


def check_installed() -> None:
    """Raises UsageError where simulation or learning is not installed."""
    if missing := [extra for package, extra in NEEDS.items() if importlib.util.find_spec(package) is None]:
        raise UsageError(f"this trains and simulates: pip install 'jiti[{','.join(dict.fromkeys(missing))}]'")
