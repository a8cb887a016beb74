"""`jiti rollout --robot`, whole: from what a user asked for to what is printed."""

from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jiti.durable import make_folder
from jiti.errors import RobotError, UsageError
from jiti.runtime.guidance import CANDIDATES, WINDOW, Guidance, Pick
from jiti.runtime.robot.inference import Brain, Inference, OpenAgent, open_agent
from jiti.runtime.robot.live import LiveArm
from jiti.runtime.robot.recording import Recording
from jiti.runtime.robot.report import RobotReport
from jiti.runtime.robot.run import AfterEpisode, Runner
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.settings import VIRTUAL, RobotSettings
from jiti.runtime.robot.stops import Stopped, Stops
from jiti.runtime.robot.tick import Arrived, Tick, Watcher
from jiti.runtime.robot.virtual import VirtualArm
from jiti.runtime.rollout.live import SHOWN_SUFFIX
from jiti.runtime.rollout.plan import label_of, parse_guidance
from jiti.runtime.rollout.result import RECORDING_SUFFIX
from jiti.runtime.rollout.viewer import Viewer
from jiti.runtime.workers import alone
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig

FOLDER = Path("rollouts")
SECONDS = 30.0
"""Of an episode. Our choice: what the paper's tasks take, twice."""
SAID_S = 0.5
Say = Callable[[str], None]


@dataclass(frozen=True)
class RobotRequest:
    """The command's arguments; None is for what was not given."""

    settings: RobotSettings
    task: str | None = None
    policy: str | None = None
    critic: str | None = None
    guidance: tuple[str, ...] = ()
    pick: Pick = "best"
    candidates: int = CANDIDATES
    window: int = WINDOW
    tau: float | None = None
    tau_scale: float = 1.0
    episodes: int | None = None
    seconds: float = SECONDS
    seed: int | None = None
    device: str = "cpu"
    out: Path | None = None
    record: bool = True
    dry_run: bool = False
    live: bool = False


@dataclass(frozen=True)
class Ran:
    """What is to be printed."""

    report: RobotReport
    problem: Exception | None
    """What ended it before its time: Stopped, or an error."""


def run_robot(
    request: RobotRequest,
    catalogue: Catalogue,
    say: Say,
    *,
    make_agent: OpenAgent = open_agent,
    after_episode: AfterEpisode = lambda _recorded: None,
    cameras: "dict[str, CameraConfig] | None" = None,
) -> Ran:
    """Play episodes on an arm, which has no torque afterwards, whatever happened; what was recorded is kept. `cameras`
    are taken instead of those of the settings.

    Raises UsageError for what does not fit together or is missing, RobotError for an arm that cannot begin.
    """
    ran: list[Ran] = []
    if request.dry_run:  # a recording would be taken for one of an arm that moved
        request = replace(request, record=False)
    try:
        _run(request, catalogue, say, make_agent, after_episode, cameras, ran.append)
    except (RobotError, Stopped) as error:  # at the end, where an arm is let go
        if not ran:
            raise
        return replace(ran[0], problem=ran[0].problem or error)
    return ran[0]


def _run(
    request: RobotRequest,
    catalogue: Catalogue,
    say: Say,
    make_agent: OpenAgent,
    after_episode: AfterEpisode,
    cameras: "dict[str, CameraConfig] | None",
    ended: Callable[[Ran], None],
) -> None:
    """`ended` is told what is to be printed, before all is closed."""
    task, guidance = _task(request, catalogue), _guidance(request)
    if request.policy is None:
        raise UsageError("an arm needs a policy of its own: pass --policy, a checkpoint or run of lerobot-train.")
    label, folder = label_of(guidance), request.out or FOLDER / task.task_id.replace("/", "-")
    brain = Brain(request.policy, request.critic, guidance, task.instruction, request.device, request.settings.execute)
    paths = _paths(request, folder / label, task)
    with ExitStack() as stack:
        stops = stack.enter_context(Stops())
        make_folder(folder)
        stack.enter_context(alone(folder, "jiti rollout"))
        inference = stack.enter_context(Inference(brain, make_agent))
        arm = stack.enter_context(_arm(request, task, stack, say, cameras))

        viewer = Viewer(say) if request.live else None
        if viewer is not None:
            stack.callback(viewer.close)

        def recording(seed: int) -> Recording:
            path = paths[seed]
            about = {"task": task.task_id, "robot": request.settings.kind, "guidance": label, "seed": str(seed)}
            names = tuple(arm.robot.cameras)
            shown = None
            if viewer is not None:
                make_folder(path.parent)
                shown = LiveArm(path.with_suffix(SHOWN_SUFFIX), viewer.address, arm.joints, names, guidance.tau)
            kept = path if request.record else None
            return Recording(kept, arm.joints, names, instruction=task.instruction, about=about, shown=shown)

        runner = Runner(arm, inference, stops, task, label, recording, after_episode)
        if request.dry_run:
            runner.watchers = (Told(say, arm.joints),)
        say("Loading policy and critic; the arm has no torque.")
        facts = runner.open()
        if request.dry_run:
            say("Dry run: nothing is sent.")
        keys = (
            "Space stops the arm at once, Enter ends an episode." if stops.keys else "Ctrl-C or SIGTERM stops the arm."
        )
        say(keys)
        done, problem = runner.play(facts, list(paths), request.seconds)
        taken = {"policy": request.policy, "critic": request.critic, "settings": asdict(request.settings)}
        taken |= {"tau": guidance.tau, "execute": facts.execute, "dry_run": request.dry_run}
        report = RobotReport(
            task.task_id, request.settings.kind, label, taken, done, arm.misread, arm.overloads, folder
        )
        ended(Ran(report, problem))
        if viewer is not None and problem is None:
            with suppress(Stopped):
                viewer.wait()


def _paths(request: RobotRequest, folder: Path, task: Task) -> dict[int, Path]:
    """Of each seed's recording. Without a first seed they go on behind those there; raises UsageError where one
    would take another's place."""
    stem = task.task_id.replace("/", "-")

    def path(seed: int) -> Path:
        return folder / f"{stem}_{seed:04d}{RECORDING_SUFFIX}"

    there = [int(one.stem.rpartition("_")[2]) for one in folder.glob(f"{stem}_[0-9]*{RECORDING_SUFFIX}")]
    first = max(there, default=-1) + 1 if request.seed is None else request.seed
    seeds = range(first, first + (request.episodes or 1))
    if request.record and (taken := set(seeds) & set(there)):
        raise UsageError(f"{path(min(taken))} is there already: leave --seed out, or pass another --out.")
    return {seed: path(seed) for seed in seeds}


def _arm(
    request: RobotRequest, task: Task, stack: ExitStack, say: Say, cameras: "dict[str, CameraConfig] | None"
) -> SafeArm:
    settings = request.settings
    if not settings.port:
        raise UsageError("which port? Pass --port /dev/ttyACM0 (`lerobot-find-port` tells it), or --port virtual.")
    if settings.port == VIRTUAL:
        virtual = stack.enter_context(VirtualArm(task.task_id, seed=request.seed or 0))
        settings = replace(settings, port=virtual.port, id=virtual.id, calibration_dir=str(virtual.calibration_dir))
        cameras = cameras or virtual.cameras()
    return SafeArm(settings, dry=request.dry_run, say=say, cameras=cameras)


def _task(request: RobotRequest, catalogue: Catalogue) -> Task:
    if request.task is None:
        raise UsageError("which task? Pass --task so100/T4; `jiti tasks` lists all, --tasks adds your own.")
    return catalogue.task(request.task)


def _guidance(request: RobotRequest) -> Guidance:
    wanted = list(request.guidance) or ["jiti" if request.critic else "none"]
    if len(wanted) > 1:
        raise UsageError("an arm plays one guidance at a time: pass one --guidance.")
    method, pick = parse_guidance(wanted[0], request.pick)
    if method != "none" and request.critic is None:
        raise UsageError(f"--guidance {method} needs a critic: pass --critic RUN.")
    tau = None
    if method == "jiti":
        if request.tau is None:
            raise UsageError(
                "JITI needs a threshold: pass --tau. Play some episodes with --tau inf first: delta_q in their "
                ".decisions.parquet says what jumps there are, of which a third is to be above tau (G.6)."
            )
        tau = request.tau * request.tau_scale
    return Guidance(method, pick, request.candidates, request.window, tau)


class Told(Watcher):
    """Says twice a second where the arm would be sent."""

    def __init__(self, say: Say, joints: tuple[str, ...]) -> None:
        self._say, self._joints, self._said_ns = say, joints, 0

    def ticked(self, tick: Tick) -> None:
        if tick.asked is None or tick.time_ns - self._said_ns < SAID_S * 1e9:
            return
        self._said_ns = tick.time_ns
        seen: Any = tick.seen
        places = (f"{name} {seen[f'{name}.pos']:.0f} -> {tick.asked[name]:.0f}" for name in self._joints)
        held_back = f" (held back: {', '.join(tick.clamped)})" if tick.clamped else ""
        self._say(f"step {tick.tick}: {', '.join(places)}{held_back}")

    def arrived(self, arrived: Arrived) -> None:
        pass
