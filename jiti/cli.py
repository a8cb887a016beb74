"""The `jiti` command. Each subcommand parses, imports what it needs, calls one function and prints."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jiti import __version__
from jiti.errors import JitiError, UsageError
from jiti.progress import Progress

if TYPE_CHECKING:
    from jiti.annotate.web.session import Session


class ProposalSource(StrEnum):
    """Who proposes segments."""

    sim = "sim"
    signal = "signal"


class Stage(StrEnum):
    """What a model is asked."""

    itcs = "itcs"
    segments = "segments"
    verdicts = "verdicts"


class Unlabelled(StrEnum):
    """What becomes of episodes without labels."""

    leave = "leave"
    keep = "keep"


class VideoCodec(StrEnum):
    """How videos are encoded."""

    h264 = "h264"
    hevc = "hevc"
    av1 = "av1"


class Engine(StrEnum):
    """Where episodes are worked on."""

    local = "local"
    ray = "ray"


class Start(StrEnum):
    """Where episodes in simulation begin."""

    jitter = "jitter"
    file = "file"
    sampled = "sampled"


class Arm(StrEnum):
    """Arms that a policy can be played on."""

    so100 = "so100"
    so101 = "so101"


class PickRank(StrEnum):
    """Which candidate is taken, by the critic's value."""

    best = "best"
    median = "median"
    worst = "worst"
    random = "random"


app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # with Rich the help takes five times as long to appear
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Label how robot demonstrations were done, and learn from those labels.",
)

Source = Annotated[
    str | None,
    typer.Argument(help="An MCAP file, a folder of them, a LeRobot folder or Hub id. Default: the current folder."),
]
Tasks = Annotated[
    list[Path] | None,
    typer.Option("--tasks", help="A TOML file with your tasks and ITCs; may be repeated. Default: tasks.toml there."),
]
Labels = Annotated[Path | None, typer.Option("--labels", help="Folder of the labels. Default: beside the recordings.")]
Annotator = Annotated[str | None, typer.Option("--annotator", help="Who labels. Default: your login name.")]
Assets = Annotated[
    str | None, typer.Option("--assets", help="Asset pack: primitive (the default), libero, or a folder.")
]
Port = Annotated[
    int, typer.Option("--port", min=0, max=65535, show_default=False, help="Port on 127.0.0.1. Default: any free one.")
]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")]
ArmPort = Annotated[
    str | None, typer.Option("--port", help="Of the arm: /dev/ttyACM0, or virtual for a simulated one.")
]
RobotId = Annotated[
    str | None, typer.Option("--robot-id", help="By which lerobot knows its calibration. Default: follower.")
]
RobotConfig = Annotated[
    Path | None, typer.Option("--robot-config", help="A TOML file with the arm, its cameras and limits.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for scripts.")]

QUIET_S = 20.0
"""Longest time without a word where there is no terminal to show a bar on."""


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"jiti {__version__}")
        raise typer.Exit


@app.callback()
def about(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Label how robot demonstrations were done, and learn from those labels."""


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
    _say_session(session)
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

        with _progress("Opening recordings") as progress:
            changed = confirm_recordings(session, progress)
        print(f"Confirmed the labels of {len(changed)} episodes whose recordings were changed.")
    elif write:
        from jiti.curate.rewards_file import write_rewards

        print(f"Wrote {write_rewards(session.store.labels_dir, gamma=gamma)}.")
    elif check:
        from jiti.curate.validate import check_labels, print_check

        with _progress("Opening recordings") as progress:
            found = check_labels(session, gamma=gamma, progress=progress)
        print_check(found, as_json=as_json)
        raise typer.Exit(1 if found.errors else 0)
    else:
        from jiti.annotate.web.serve import serve
        from jiti.curate.rvv import rvv_routes

        _say_session(session)
        serve(session, path=f"/rewards?gamma={gamma:g}", port=port, browser=not no_browser, routes=rvv_routes(session))


@app.command(short_help="List episodes, streams and problems.")
def inspect(source: Source = None, as_json: Json = False) -> None:
    """List the episodes of a source, their streams, and what is wrong with them. Exits with 1 when none can be opened.

    Example: jiti inspect episode.mcap --json
    """
    from jiti.episodes.inspect import inspect_source, print_report

    with _progress("Reading") as progress:
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
    with _progress("Checking") as progress:
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
    with _progress("Proposing") as progress:
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


@app.command(short_help="Make a LeRobot dataset of recordings and their labels.")
def curate(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SOURCE",
            help="MCAP files, folders of them, LeRobot folders or Hub ids, merged. Default: the current folder.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the dataset.")] = None,
    labels: Annotated[
        list[Path] | None,
        typer.Option("--labels", help="Folder of the labels: one for all sources, or one for each. Default: beside."),
    ] = None,
    tasks: Tasks = None,
    rule: Annotated[
        str, typer.Option("--rule", help="Whose labels count: majority, adjudicated, or one annotator's name.")
    ] = "majority",
    accept: Annotated[
        list[str] | None,
        typer.Option("--accept", help="Count a machine's proposals that no one has settled (sim); may be repeated."),
    ] = None,
    unlabelled: Annotated[
        Unlabelled, typer.Option("--unlabelled", help="Leave episodes without labels out, or keep them.")
    ] = Unlabelled.leave,
    features: Annotated[
        Path | None, typer.Option("--features", help="A TOML file: which stream becomes which feature.")
    ] = None,
    show_features: Annotated[
        bool, typer.Option("--print-features", help="Print the automatic mapping as such a file, and end.")
    ] = False,
    fps: Annotated[
        int | None, typer.Option("--fps", min=1, max=1000, help="Resample to this rate. Default: the recordings' own.")
    ] = None,
    condition: Annotated[
        str | None,
        typer.Option("--filter", help="Keep only these episodes: 'reward == 1', 'success and frames < 400'."),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            "--split",
            help="Shares of train, validation and test, by episode. "
            "Default: the splits that a dataset of jiti has, 0.8,0.1,0.1 for the rest.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the splits. Default: 0.")] = None,
    unseen: Annotated[
        list[str] | None,
        typer.Option("--unseen", help="A task (T7) that goes whole into the split `unseen`; may be repeated."),
    ] = None,
    gamma: Annotated[float, typer.Option("--gamma", min=0.0, max=1.0, help="Discount of the return.")] = 0.98,
    codec: Annotated[
        VideoCodec | None,
        typer.Option("--codec", help="Encode videos with it. Default: copy LeRobot's videos, h264 for the rest."),
    ] = None,
    crf: Annotated[
        int | None, typer.Option("--crf", min=0, help="Quality of videos, 0 (best) to 51, or to 63 with av1.")
    ] = None,
    weights: Annotated[
        bool, typer.Option("--weights", help="Write weights of frames too, as lerobot-train takes them (RA-BC).")
    ] = False,
    weights_from: Annotated[
        str | None,
        typer.Option(
            "--weights-from",
            metavar="RUN",
            help="Such weights by the critic of a run of train-critic; without --out, of the dataset SOURCE.",
        ),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write a page about the dataset; without --out, of the dataset SOURCE.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a dataset that is there.")] = False,
    as_json: Json = False,
) -> None:
    """Merge recordings and the labels that count into D_elegant, a LeRobot v3 dataset; a stopped run goes on.

    Example: jiti curate demos --accept sim --out d-elegant --filter 'reward == 1' --report
    """
    from jiti.curate.export import command

    if weights and weights_from:
        raise UsageError("--weights and --weights-from write the same file: pass one of them.")
    request = command.Request(
        sources=tuple(sources or ()),
        out=out,
        labels=tuple(labels or ()),
        tasks=tuple(tasks or ()),
        rule=rule,
        accept=tuple(accept or ()),
        unlabelled=unlabelled.value,
        features=features,
        fps=fps,
        condition=condition,
        split=split,
        seed=seed,
        unseen=tuple(unseen or ()),
        gamma=gamma,
        codec=codec.value if codec else None,
        crf=crf,
        weights=weights,
        report=report,
        overwrite=overwrite,
    )
    if show_features:
        with _progress("Opening recordings") as progress:
            shown = command.print_features(request, progress)
        print(shown, end="")
        return
    weigh = None
    if weights_from:
        from jiti.critic.weigh import weigher

        weigh = weigher(weights_from)
    with _progress("Curating") as progress:
        try:
            done = command.run(request, progress, weigh)
        except KeyboardInterrupt as stop:
            _say(" ".join(map(str, ("Stopped.", *stop.args))))  # what is kept, where something was written
            raise
    print(done.to_json() if as_json else done)


@app.command(short_help="Record demonstrations, in simulation or on an arm.")
def record(
    context: typer.Context,
    task: Annotated[str, typer.Option("--task", help="T2, rq3/seen-A, close-microwave; on an arm, any: so100/T5.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the recordings. Default: jiti-TASK.")] = None,
    episodes: Annotated[int, typer.Option("--episodes", min=1, help="Episodes that are there in the end.")] = 10,
    quality: Annotated[
        float, typer.Option("--quality", min=0.0, max=1.0, help="Share that is meant to be elegant.")
    ] = 0.5,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first episode; the next has the next.")] = 0,
    cameras: Annotated[str, typer.Option("--cameras", help="front,wrist or none.")] = "front,wrist",
    assets: Assets = None,
    start: Annotated[
        Start,
        typer.Option(
            "--start",
            help="LIBERO's initial states, moved a little (jitter) or as they are (file), "
            "or places drawn anew (sampled).",
        ),
    ] = Start.jitter,
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Processes. Default: one a core.")] = None,
    robot: Annotated[
        Arm | None, typer.Option("--robot", help="Record a person on an arm instead: so100, so101.")
    ] = None,
    port: ArmPort = None,
    robot_id: RobotId = None,
    robot_config: RobotConfig = None,
    leader: Annotated[
        str | None,
        typer.Option("--leader", metavar="PORT", help="Of an arm to follow, or virtual. Without it: moved by hand."),
    ] = None,
    leader_id: Annotated[
        str | None, typer.Option("--leader-id", help="By which lerobot knows its calibration. Default: leader.")
    ] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, help="Of the longest episode on an arm.")] = 60.0,
    tasks: Tasks = None,
    as_json: Json = False,
) -> None:
    """Record scripted demonstrations of mixed quality to MCAP; one that was stopped goes on where it was.

    With --robot a person demonstrates on an arm, with a leader or by hand; see docs/so100.md first.

    Example: jiti record --task T2 --episodes 40 --quality 0.5 --out demos

    Example: jiti record --robot so100 --port virtual --leader virtual --task so100/T5 --episodes 4
    """
    given = {name for name in context.params if str(context.get_parameter_source(name)).endswith("COMMANDLINE")}
    if given & {"robot", "port", "robot_config"}:
        if wrong := given & {"cameras", "assets", "start", "workers"}:
            named = ", ".join(f"--{name}" for name in sorted(wrong))
            raise UsageError(f"{named}: for simulation; an arm's cameras stand in the file of --robot-config.")
        _record_on_robot(
            {"kind": robot and robot.value, "port": port, "id": robot_id, "leader": leader, "leader_id": leader_id},
            robot_config,
            tasks,
            as_json,
            task=task,
            episodes=episodes,
            seconds=seconds,
            seed=seed,
            quality=quality if "quality" in given else None,
            out=out,
        )
        return
    if wrong := given & {"robot_id", "leader", "leader_id", "seconds"}:
        named = ", ".join(f"--{name.replace('_', '-')}" for name in sorted(wrong))
        raise UsageError(f"{named}: for an arm; pass --robot so100 and --port too.")
    from jiti.runtime.sim.record import Plan, print_recorded
    from jiti.runtime.sim.record import record as record_all
    from jiti.tasks.catalogue import load_catalogue

    found = load_catalogue(*tasks or ()).simulated(task)
    shown = () if cameras == "none" else tuple(name.strip() for name in cameras.split(","))
    plan = Plan(found, quality=quality, seed=seed, start=start.value, assets=assets, cameras=shown)
    folder = out or Path(f"jiti-{found.task_id.replace('/', '-')}")
    with _progress("Recording") as progress:
        try:
            recorded = record_all(plan, folder, episodes=episodes, workers=workers, progress=progress)
        except KeyboardInterrupt:
            print(f"Stopped. What is whole stays in {folder}; the same command goes on there.", file=sys.stderr)
            raise
    print_recorded(recorded, folder, as_json=as_json)


def _record_on_robot(
    flags: dict[str, str | None], config: Path | None, tasks: list[Path] | None, as_json: bool, **asked: Any
) -> None:
    """`jiti record --robot`."""
    from jiti.runtime.robot.demonstrate import RecordRequest, record_robot
    from jiti.runtime.robot.settings import read_settings
    from jiti.runtime.robot.stops import Stopped
    from jiti.tasks.catalogue import load_catalogue

    request = RecordRequest(read_settings(config, **flags), **asked)
    try:
        done = record_robot(request, load_catalogue(*tasks or ()), _say)
    except Stopped as stopped:  # before anything was recorded
        raise typer.Exit(stopped.exit_code) from None
    if as_json:
        print(done.there.to_json())
    else:
        done.there.print()
    if isinstance(done.problem, Stopped):
        raise typer.Exit(done.problem.exit_code)
    if done.problem is not None:
        raise done.problem


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
    with _progress("Demo") as progress:
        done = _until_stopped(lambda: run_demo(request, progress, _say))
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
    with _progress("Benchmark") as progress:
        done = _until_stopped(lambda: run_request(request, progress, _say))
    print(done.to_json() if as_json else done)


@app.command("train-critic", short_help="Train the Elegance Critic on D_elegant.")
def train_critic(
    dataset: Annotated[
        Path | None, typer.Argument(help="A dataset of `jiti curate`. With --evaluate: the run's.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the run; a run there goes on.")] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="TOML file of settings, or `state`: minutes on two cores. Default: the paper's."),
    ] = None,
    features: Annotated[
        str | None, typer.Option("--features", help="state, or smolvla:, groot:, policy: and a folder or Hub id.")
    ] = None,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="Gradient steps.")] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of weights, order and noise.")] = None,
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes that compute features.")] = 1,
    cache: Annotated[
        Path | None, typer.Option("--cache", help="Folder of features. Default: your cache folder.")
    ] = None,
    evaluate: Annotated[
        Path | None, typer.Option("--evaluate", metavar="RUN", help="Say how well the critic of a run does.")
    ] = None,
    split: Annotated[
        str | None, typer.Option("--split", help="Episodes for --evaluate, or all. Default: test.")
    ] = None,
    episodes: Annotated[
        list[int] | None, typer.Option("--episode", help="With --evaluate: one to show in Rerun; may be repeated.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Train the Elegance Critic by Cal-QL, or say how well one does on episodes that it did not see.

    Example: jiti train-critic dataset --out run && jiti train-critic --evaluate run
    """
    from jiti.critic.command import Request, evaluate_request, train_request

    request = Request(
        dataset, out, config, features, steps, seed, workers, cache, evaluate, split, tuple(episodes or ())
    )
    with _progress("Evaluating" if evaluate else "Training") as progress:
        work = evaluate_request if evaluate else train_request
        done = _until_stopped(lambda: work(request, progress))
    print(done.to_json() if as_json else done)


@app.command(short_help="Play a policy in simulation, alone and guided by a critic.")
def rollout(
    task: Annotated[
        str | None, typer.Option("--task", help="A task of simulation. Default: the newest recording's here.")
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option("--policy", help="A checkpoint or run of lerobot-train, or Hub id. Default: the newest."),
    ] = None,
    critic: Annotated[
        str | None, typer.Option("--critic", help="A run of train-critic, or Hub id. Default: the newest here.")
    ] = None,
    guidance: Annotated[
        list[str] | None,
        typer.Option(
            "--guidance",
            metavar="METHOD[:PICK]",
            help="none, jiti or full; jiti:random picks so. Repeated, they are compared. Default: none and jiti.",
        ),
    ] = None,
    pick: Annotated[PickRank, typer.Option("--pick", help="Of the candidates, by the critic's value.")] = PickRank.best,
    candidates: Annotated[int, typer.Option("--candidates", min=1, help="N, the default chunk among them.")] = 8,
    window: Annotated[int, typer.Option("--window", min=1, help="k, values in the mean that a jump is from.")] = 2,
    tau: Annotated[
        float | None, typer.Option("--tau", min=0.0, help="Threshold of a jump. Default: as it was calibrated.")
    ] = None,
    tau_scale: Annotated[float, typer.Option("--tau-scale", help="Multiple of tau that is applied.")] = 1.0,
    calibrate_tau: Annotated[
        float | None,
        typer.Option("--calibrate-tau", metavar="RATE", help="Only find the tau at which this share triggers."),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option("--episodes", min=1, show_default=False, help="For each guidance. Default: 50; to calibrate 20."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed", min=0, show_default=False, help="Of the first episode. Default: 100000; to calibrate 200000."
        ),
    ] = None,
    start: Annotated[
        Start, typer.Option("--start", help="LIBERO's initial states, moved a little or as they are, or drawn anew.")
    ] = Start.jitter,
    assets: Assets = None,
    cameras: Annotated[
        str | None, typer.Option("--cameras", help="front,wrist or none. Default: none, unless the policy looks.")
    ] = None,
    max_steps: Annotated[int, typer.Option("--max-steps", min=1, help="Steps at which an episode is cut off.")] = 600,
    device: Annotated[str, typer.Option("--device", help="Of policy and critic: cpu, cuda.")] = "cpu",
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Processes. Default: one a core.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the rollouts. Default: rollouts/TASK.")] = None,
    record: Annotated[bool, typer.Option("--record/--no-record", help="Write each episode to MCAP.")] = True,
    branch: Annotated[
        str | None,
        typer.Option("--branch", metavar="PICKS", help="Continue one episode in several ways: best,median,worst."),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Show episodes in Rerun while they are played.")] = False,
    robot: Annotated[Arm | None, typer.Option("--robot", help="Play on an arm instead: so100, so101.")] = None,
    port: Annotated[
        str | None, typer.Option("--port", help="Of the arm: /dev/ttyACM0, or virtual for a simulated one.")
    ] = None,
    robot_id: Annotated[
        str | None, typer.Option("--robot-id", help="By which lerobot knows its calibration. Default: follower.")
    ] = None,
    robot_config: Annotated[
        Path | None, typer.Option("--robot-config", help="A TOML file with the arm, its cameras and limits.")
    ] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, help="Of an episode on an arm.")] = 30.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say where the arm would go, and send it nothing.")
    ] = False,
    judge: Annotated[
        bool, typer.Option("--judge", help="On an arm: ask after each episode how it was; compares guidances.")
    ] = False,
    blind: Annotated[
        bool, typer.Option("--blind/--not-blind", help="Tell which guidance it was only when all is judged.")
    ] = True,
    tasks: Tasks = None,
    as_json: Json = False,
) -> None:
    """Play a policy in simulation, alone and guided by a critic, from the same initial states, and compare.

    Without options it takes the newest policy, critic and recorded task here, and says which. A stopped run goes on.
    With --robot it plays on an arm, one guidance, or several with --judge; see docs/so100.md first.

    Example: jiti rollout --task elegant/T2 --policy policy --critic critic --guidance none --guidance jiti

    Example: jiti rollout --robot so100 --port virtual --task so100/T4 --policy policy --guidance none
    """
    if robot is not None or robot_config is not None or port is not None:
        if branch is not None:
            raise UsageError("--branch is for simulation: leave it out, or --robot and --port.")
        _play_on_robot(
            {"kind": robot and robot.value, "port": port, "id": robot_id},
            robot_config,
            tasks,
            as_json,
            task=task,
            policy=policy,
            critic=critic,
            guidance=tuple(guidance or ()),
            pick=pick.value,
            candidates=candidates,
            window=window,
            tau=tau,
            tau_scale=tau_scale,
            calibrate_tau=calibrate_tau,
            episodes=episodes,
            seconds=seconds,
            seed=seed,
            device=device,
            out=out,
            record=record,
            dry_run=dry_run,
            live=live,
            judge=judge,
            blind=blind,
        )
        return
    from jiti.runtime.sim.engine import find_robosuite
    from jiti.tasks.catalogue import load_catalogue

    find_robosuite()
    from jiti.runtime.rollout.command import Request, names, run_request

    request = Request(
        task=task,
        policy=policy,
        critic=critic,
        guidance=tuple(guidance or ()),
        pick=pick.value,
        candidates=candidates,
        window=window,
        tau=tau,
        tau_scale=tau_scale,
        calibrate_tau=calibrate_tau,
        episodes=episodes,
        seed=seed,
        start=start.value,
        assets=assets,
        cameras=None if cameras is None else names(cameras),
        most_steps=max_steps,
        device=device,
        workers=workers,
        out=out,
        record=record,
        branch=names(branch or "none"),
        live=live,
    )
    catalogue = load_catalogue(*tasks or ())
    with _progress("Playing") as progress:
        try:
            done = run_request(request, catalogue, progress, lambda said: print(said, file=sys.stderr))
        except KeyboardInterrupt:
            print("Stopped. Whole episodes are kept; the same command goes on there.", file=sys.stderr)
            raise
    if as_json:
        print(done.to_json())
    else:
        done.print()


def _play_on_robot(
    flags: dict[str, str | None], config: Path | None, tasks: list[Path] | None, as_json: bool, **asked: Any
) -> None:
    """`jiti rollout --robot`."""
    from jiti.runtime.robot.command import run_robot
    from jiti.runtime.robot.request import RobotRequest
    from jiti.runtime.robot.settings import read_settings
    from jiti.runtime.robot.stops import Stopped
    from jiti.tasks.catalogue import load_catalogue

    request = RobotRequest(read_settings(config, **flags), **asked)
    try:
        ran = run_robot(request, load_catalogue(*tasks or ()), lambda said: print(said, file=sys.stderr))
    except Stopped as stopped:  # before the arm had torque
        raise typer.Exit(stopped.exit_code) from None
    if as_json:
        print(ran.to_json())
    else:
        ran.print()
    if isinstance(ran.problem, Stopped):
        raise typer.Exit(ran.problem.exit_code)
    if ran.problem is not None:
        raise ran.problem


@contextmanager
def _progress(what: str) -> Iterator[Progress]:
    """A bar on a terminal, a line every `QUIET_S` elsewhere; called with the share done and what is being done."""
    from time import monotonic

    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    said = monotonic()

    def tell(share: float, now: str) -> None:
        nonlocal said
        if console.is_terminal:
            bar.update(task, completed=share, description=now)
        elif monotonic() - said > QUIET_S:
            said = monotonic()
            print(f"{what}: {share:.0%}, {now}", file=sys.stderr)

    with Bar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)
        yield tell


def _say(what: str) -> None:
    print(what, file=sys.stderr)


def _until_stopped[T](work: Callable[[], T]) -> T:
    try:
        return work()
    except KeyboardInterrupt:
        _say("Stopped. What is finished is kept; the same command goes on there.")
        raise


def _say_session(session: "Session") -> None:
    print(f"{session.reader.title}. Labels of {session.annotator} go to {session.store.labels_dir}.")


def main() -> None:
    """Run the command line; a JitiError becomes one message and exit code 1."""
    try:
        app()
    except JitiError as error:
        print(f"jiti: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
