"""Commands of whole chains: demo, benchmark."""

from pathlib import Path
from typing import Annotated

import typer

from jiti.cli.app import app
from jiti.cli.labels import annotate
from jiti.cli.options import Assets, Json, NoBrowser, Port
from jiti.cli.telling import progress_bar, say, until_stopped


@app.command(short_help="The whole chain on one task, in minutes.")
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder of all that it makes.")] = Path("jiti-demo"),
    task: Annotated[str, typer.Option("--task", help="A task of simulation.")] = "elegant/T2",
    episodes: Annotated[int, typer.Option("--episodes", min=2, help="Demonstrations to record.")] = 40,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first demonstration.")] = 0,
    rollouts: Annotated[int, typer.Option("--rollouts", min=1, help="Rollouts of each guidance.")] = 20,
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Processes. Default: one a core.")] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A minute or two that show that it runs; the figures mean nothing.")
    ] = False,
    headless: Annotated[bool, typer.Option("--headless", help="End after writing, open nothing.")] = False,
    as_json: Json = False,
    port: Port = 0,
    no_browser: NoBrowser = False,
) -> None:
    """Record demonstrations, label them, train policy and critic, roll out with and without guidance; then open ESA.

    Example: jiti demo --headless
    """
    from jiti.runtime.benchmark.demo import Request
    from jiti.runtime.benchmark.demo import demo as run_demo

    request = Request(out, task, episodes, seed, rollouts, workers, quick)
    with progress_bar("Demo") as progress:
        done = until_stopped(lambda: run_demo(request, progress, say))
    print(done.to_json() if as_json else done)
    if not (headless or as_json):
        annotate(str(out), port=port, no_browser=no_browser)


@app.command(short_help="The paper's tables, from recordings to a report.")
def benchmark(
    plan: Annotated[
        str, typer.Option("--plan", help="table8, libero, rq3, g4-rigid, g4-articulated, g5, g6, or a TOML file.")
    ] = "table8",
    out: Annotated[Path, typer.Option("--out", help="Work folder; several plans may share one.")] = Path("benchmark"),
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            help="A stage: record, autolabel, curate, policies, critics, tau, rollouts, report; may be repeated.",
        ),
    ] = None,
    columns: Annotated[
        str | None, typer.Option("--columns", help="Columns to play, with commas between. Default: all.")
    ] = None,
    tasks: Annotated[
        str | None, typer.Option("--tasks", help="Tasks to play, with commas between: T0,T2. Default: all.")
    ] = None,
    task_files: Annotated[
        list[Path] | None, typer.Option("--task-file", help="A TOML file with your tasks; may be repeated.")
    ] = None,
    episodes: Annotated[int | None, typer.Option("--episodes", min=1, help="Rollouts a cell.")] = None,
    assets: Assets = None,
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Processes. Default: one a core.")] = None,
    tuning: Annotated[
        bool, typer.Option("--tuning", help="Play from the tuning seeds, not from those that are reported.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="A few minutes that show that it runs; the figures mean nothing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Play a plan's columns on its tasks, and write its tables beside the paper's; a stopped run goes on where it was.

    Example: jiti benchmark --plan table8 --out benchmark
    """
    from jiti.runtime.benchmark.command import Request, run_request

    def split(text: str | None) -> tuple[str, ...]:
        return tuple(part.strip() for part in text.split(",") if part.strip()) if text else ()

    request = Request(
        plan,
        out,
        tuple(only or ()),
        split(columns),
        split(tasks),
        tuple(task_files or ()),
        episodes,
        assets,
        workers,
        tuning,
        quick,
    )
    with progress_bar("Benchmark") as progress:
        done = until_stopped(lambda: run_request(request, progress, say))
    print(done.to_json() if as_json else done)
