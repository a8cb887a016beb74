"""Commands of labels: annotate, validate-rewards, inspect, tasks, autolabel."""

from pathlib import Path
from typing import Annotated

import typer

from jiti.cli.app import app
from jiti.cli.options import (
    Annotator,
    Assets,
    Engine,
    Json,
    Labels,
    NoBrowser,
    Port,
    ProposalSource,
    Source,
    Stage,
    Tasks,
)
from jiti.cli.telling import progress_bar, say_session
from jiti.errors import UsageError


@app.command(short_help="Mark segments and verdicts in a browser (ESA).")
def annotate(
    source: Source = None,
    annotator: Annotator = None,
    labels: Labels = None,
    tasks: Tasks = None,
    port: Port = 0,
    no_browser: NoBrowser = False,
) -> None:
    """Open the Elegance Segment Annotator (ESA) in a browser.

    Example: jiti annotate episode.mcap
    """
    from jiti.annotate.web.serve import serve
    from jiti.annotate.web.session import open_session

    session = open_session(source, annotator=annotator, labels=labels, tasks=tasks)
    say_session(session)
    serve(session, port=port, browser=not no_browser)


@app.command("validate-rewards", short_help="Show rewards and returns, find mistakes (RVV).")
def validate_rewards(
    source: Source = None,
    annotator: Annotator = None,
    labels: Labels = None,
    tasks: Tasks = None,
    port: Port = 0,
    no_browser: NoBrowser = False,
    check: Annotated[
        bool, typer.Option("--check", help="List mistakes in the terminal; exit code 1 when there are errors.")
    ] = False,
    agreement: Annotated[
        tuple[str, str] | None, typer.Option("--agreement", metavar="A B", help="Compare two annotators.")
    ] = None,
    write: Annotated[bool, typer.Option("--write", help="Write rewards and returns to rewards.parquet.")] = False,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Say that the labels fit recordings that were changed since.")
    ] = False,
    gamma: Annotated[float, typer.Option("--gamma", min=0.0, max=1.0, help="Discount of the return.")] = 0.98,
    as_json: Json = False,
) -> None:
    """Open the Reward Validation Viewer (RVV), or check labels in the terminal.

    Example: jiti validate-rewards --check
    """
    from jiti.annotate.web.session import open_session

    if sum((check, write, confirm, agreement is not None)) > 1:
        raise UsageError("--check, --write, --confirm and --agreement A B are four commands: pass one of them.")
    if as_json and not (check or agreement):
        raise UsageError("--json needs --check or --agreement A B.")
    if labels is not None and not labels.exists() and (check or write or confirm or agreement):
        raise UsageError(f"--labels {labels} does not exist: there is nothing to check.")
    session = open_session(source, annotator=annotator, labels=labels, tasks=tasks)
    if agreement:
        from jiti.annotate.agreement import compare_labels, print_agreement

        print_agreement(compare_labels(session.store.labels_dir, *agreement), as_json=as_json)
    elif confirm:
        from jiti.annotate.confirm import confirm_recordings

        with progress_bar("Opening recordings") as progress:
            changed = confirm_recordings(session, progress)
        print(f"Confirmed the labels of {len(changed)} episodes whose recordings were changed.")
    elif write:
        from jiti.curate.rewards_file import write_rewards

        print(f"Wrote {write_rewards(session.store.labels_dir, gamma=gamma)}.")
    elif check:
        from jiti.curate.validate import check_labels, print_check

        with progress_bar("Opening recordings") as progress:
            found = check_labels(session, gamma=gamma, progress=progress)
        print_check(found, as_json=as_json)
        raise typer.Exit(1 if found.errors else 0)
    else:
        from jiti.annotate.web.serve import serve
        from jiti.curate.rvv import rvv_routes

        say_session(session)
        serve(session, path=f"/rewards?gamma={gamma:g}", port=port, browser=not no_browser, routes=rvv_routes(session))


@app.command(short_help="List episodes, streams and problems.")
def inspect(source: Source = None, as_json: Json = False) -> None:
    """List the episodes of a source, their streams, and what is wrong with them. Exits with 1 when none can be opened.

    Example: jiti inspect episode.mcap --json
    """
    from jiti.episodes.inspect import inspect_source, print_report

    with progress_bar("Reading") as progress:
        report = inspect_source(source, progress=lambda done, total: progress(done / max(1, total), "Reading"))
    print_report(report, as_json=as_json)
    if not report.readable:
        raise typer.Exit(1)


tasks_app = typer.Typer()
app.add_typer(tasks_app, name="tasks", short_help="List tasks and their constraints (ITCs).")


@tasks_app.callback(invoke_without_command=True)
def tasks(context: typer.Context, tasks: Tasks = None, as_json: Json = False) -> None:
    """List the tasks and their Implicit Task Constraints (ITCs).

    Example: jiti tasks --tasks mine.toml
    """
    from jiti.tasks.catalogue import load_catalogue, print_catalogue

    if context.invoked_subcommand is None:
        print_catalogue(load_catalogue(*tasks or ()), as_json=as_json)
    elif tasks or as_json:
        name = context.invoked_subcommand
        raise UsageError(f"options of `jiti tasks {name}` come after its name: jiti tasks {name} --json")


@tasks_app.command(short_help="Tell what an asset pack lacks for them.")
def check(assets: Assets = None, tasks: Tasks = None, as_json: Json = False) -> None:
    """Tell what an asset pack lacks for the tasks in simulation. Exits with 1 when it lacks something.

    Example: jiti tasks check --assets my-pack
    """
    from jiti.runtime.sim.pack_check import check_pack, find_pack, print_check
    from jiti.tasks.catalogue import load_catalogue

    pack = find_pack(assets)
    with progress_bar("Checking") as progress:
        lacks = check_pack(pack, load_catalogue(*tasks or ()), progress)
    print_check(pack, lacks, as_json=as_json)
    raise typer.Exit(1 if lacks else 0)


@app.command(short_help="Propose segments for a person to review.")
def autolabel(
    source: Source = None,
    vlm: Annotated[bool, typer.Option("--vlm", help="Ask a vision-language model: segments, then verdicts.")] = False,
    by: Annotated[
        ProposalSource | None,
        typer.Option(
            "--from",
            help="Without a model: the simulator's trace (sim) or the recording's own numbers (signal). "
            "Default: the simulator, where it recorded.",
        ),
    ] = None,
    vlm_url: Annotated[
        str | None,
        typer.Option(
            "--vlm-url", help="OpenAI-compatible server. Default: $JITI_VLM_URL, else vLLM's on this machine."
        ),
    ] = None,
    vlm_model: Annotated[
        str | None,
        typer.Option(
            "--vlm-model", help="Model of the server; without one, a folder or Hub id to run in this process."
        ),
    ] = None,
    stage: Annotated[
        Stage | None, typer.Option("--stage", help="One stage of --vlm alone. Default: segments, then verdicts.")
    ] = None,
    libero: Annotated[
        bool, typer.Option("--libero", help="With --stage itcs: for all of LIBERO's tasks, from their instructions.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Task file of --stage itcs. Default: tasks.proposed.toml there.")
    ] = None,
    cameras: Annotated[
        list[str] | None, typer.Option("--camera", help="A camera to show; may be repeated. Default: all.")
    ] = None,
    samples: Annotated[int, typer.Option("--samples", min=1, max=50, help="Answers for each verdict.")] = 3,
    fuse: Annotated[
        bool, typer.Option("--fuse/--no-fuse", help="Let recorded poses decide verdicts where they can.")
    ] = True,
    concurrency: Annotated[int, typer.Option("--concurrency", min=1, help="Requests to the server at once.")] = 8,
    timeout_s: Annotated[float, typer.Option("--vlm-timeout", min=1, help="Seconds for one request.")] = 120.0,
    prices: Annotated[
        tuple[float, float] | None,
        typer.Option("--prices", metavar="IN OUT", help="Price of a million tokens read and written, to add up cost."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say how many requests, pictures and tokens it would take; ask nothing.")
    ] = False,
    evaluate: Annotated[
        str | None,
        typer.Option("--evaluate", metavar="REFERENCE", help="Compare proposals with a person's labels, or with sim."),
    ] = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="With --vlm --evaluate: fit its confidence to the reference.")
    ] = False,
    engine: Annotated[Engine, typer.Option("--engine", help="Threads here, or Ray.")] = Engine.local,
    ray_address: Annotated[
        str | None, typer.Option("--ray-address", help="A running Ray cluster. Default: one of this machine.")
    ] = None,
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Episodes at once.")] = None,
    labels: Labels = None,
    tasks: Tasks = None,
    as_json: Json = False,
) -> None:
    """Propose a segment for every constraint of every episode. What people decided stays.

    Example: jiti autolabel demos --vlm --vlm-url http://127.0.0.1:8000/v1
    """
    from jiti.annotate import command
    from jiti.annotate.vlm.choose import Wish
    from jiti.annotate.web.session import open_session

    if vlm and by:
        raise UsageError("--vlm and --from name two who propose: pass one of them.")
    if calibrate and not evaluate:
        raise UsageError("--calibrate is of --evaluate REFERENCE.")
    if libero and not (vlm and stage == Stage.itcs and not evaluate):
        raise UsageError("--libero is of --vlm --stage itcs.")
    wish = Wish(
        url=vlm_url,
        model=vlm_model,
        cameras=tuple(cameras or ()),
        samples=samples,
        fuse=fuse,
        concurrency=concurrency,
        timeout_s=timeout_s,
    )
    request = command.Request(
        by="vlm" if vlm else by.value if by else None,
        wish=wish,
        part=stage.value if stage else None,
        out=out,
        engine=engine.value,
        workers=workers,
        address=ray_address,
        prices=prices,
    )
    with progress_bar("Proposing") as progress:
        if libero:
            from jiti.runtime.sim.libero import instructions

            folder = labels or Path("labels")
            if dry_run:
                done = command.estimate_libero(request, instructions(), folder)
            else:
                done = command.discover_libero(request, instructions(), folder, progress)
        else:
            session = open_session(source, annotator=None, labels=labels, tasks=tasks)
            if evaluate:
                done = command.evaluate_request(request, session, evaluate, fit=calibrate)
            elif dry_run:
                done = command.estimate_request(request, session, progress)
            else:
                done = command.run_request(request, session, progress)
    print(done.to_json() if as_json else done)
