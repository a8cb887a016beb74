"""Commands that record and play, in simulation or on an arm."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from jiti.cli.app import app
from jiti.cli.options import Arm, ArmPort, Assets, Json, PickRank, RobotConfig, RobotId, Start, Tasks
from jiti.cli.telling import progress_bar, say
from jiti.errors import UsageError


@app.command(short_help="Record demonstrations, in simulation or on an arm.")
def record(
    context: typer.Context,
    task: Annotated[str, typer.Option("--task", help="T2, rq3/seen-A, close-microwave; on an arm, any: so100/T5.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the recordings. Default: jiti-TASK.")] = None,
    episodes: Annotated[int, typer.Option("--episodes", min=1, help="Episodes that are there in the end.")] = 10,
    quality: Annotated[
        float, typer.Option("--quality", min=0.0, max=1.0, help="Share that is meant to be elegant.")
    ] = 0.5,
    disturbance: Annotated[
        float,
        typer.Option(
            "--disturbance",
            min=0.0,
            max=1.0,
            help="Push the hand now and then, at most so hard (1: as hard as an action can be), and record how that is "
            "made good: 0.3 is meant for policies that recover.",
        ),
    ] = 0.0,
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
        if wrong := given & {"cameras", "assets", "start", "workers", "disturbance"}:
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
    plan = Plan(
        found,
        quality=quality,
        seed=seed,
        start=start.value,
        assets=assets,
        cameras=shown,
        disturbance=disturbance,
    )
    folder = out or Path(f"jiti-{found.task_id.replace('/', '-')}")
    with progress_bar("Recording") as progress:
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
        done = record_robot(request, load_catalogue(*tasks or ()), say)
    except Stopped as stopped:  # before anything was recorded
        raise typer.Exit(stopped.exit_code) from None
    if as_json:
        print(done.there.to_json())
    else:
        done.there.print()
    _end(done.problem)


@app.command(short_help="Play a policy in simulation, alone and guided by a critic.")
def rollout(
    task: Annotated[
        str | None,
        typer.Option("--task", help="A task of simulation, or of an arm. Default: the newest recording's here."),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy", help="A checkpoint or run of lerobot-train, or Hub id. Default in simulation: the newest."
        ),
    ] = None,
    critic: Annotated[
        str | None,
        typer.Option("--critic", help="A run of train-critic, or Hub id. Default in simulation: the newest."),
    ] = None,
    guidance: Annotated[
        list[str] | None,
        typer.Option(
            "--guidance",
            metavar="METHOD[:PICK]",
            help="none, jiti or full; jiti:random picks so. Repeated, they are compared. Default: none and jiti; on an "
            "arm one.",
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
    asked: dict[str, Any] = {
        "task": task,
        "policy": policy,
        "critic": critic,
        "guidance": tuple(guidance or ()),
        "pick": pick.value,
        "candidates": candidates,
        "window": window,
        "tau": tau,
        "tau_scale": tau_scale,
        "calibrate_tau": calibrate_tau,
        "episodes": episodes,
        "seed": seed,
        "device": device,
        "out": out,
        "record": record,
        "live": live,
    }
    if robot is not None or robot_config is not None or port is not None:
        if branch is not None:
            raise UsageError("--branch is for simulation: leave it out, or --robot and --port.")
        _play_on_robot(
            {"kind": robot and robot.value, "port": port, "id": robot_id},
            robot_config,
            tasks,
            as_json,
            **asked,
            seconds=seconds,
            dry_run=dry_run,
            judge=judge,
            blind=blind,
        )
        return
    if judge or not blind:
        raise UsageError("in simulation predicates judge: --judge and --not-blind are for an arm, with --robot.")
    from jiti.runtime.sim.engine import find_robosuite
    from jiti.tasks.catalogue import load_catalogue

    find_robosuite()
    from jiti.runtime.rollout.command import Request, names, run_request

    request = Request(
        **asked,
        start=start.value,
        assets=assets,
        cameras=None if cameras is None else names(cameras),
        most_steps=max_steps,
        workers=workers,
        branch=names(branch or "none"),
    )
    catalogue = load_catalogue(*tasks or ())
    with progress_bar("Playing") as progress:
        try:
            done = run_request(request, catalogue, progress, say)
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
        ran = run_robot(request, load_catalogue(*tasks or ()), say)
    except Stopped as stopped:  # before the arm had torque
        say(f"{stopped}; nothing was played.")
        raise typer.Exit(stopped.exit_code) from None
    if as_json:
        print(ran.to_json())
    else:
        ran.print()
    _end(ran.problem)


def _end(problem: Exception | None) -> None:
    """With what ended an arm's work before its time, once all that it left is printed."""
    from jiti.runtime.robot.stops import Stopped

    if isinstance(problem, Stopped):
        raise typer.Exit(problem.exit_code)
    if problem is not None:
        raise problem
