"""`jiti record --robot`, whole: from what a user asked for to what is printed."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from jiti.durable import make_folder
from jiti.errors import RobotError, UsageError
from jiti.runtime.robot.by_hand import ByHand
from jiti.runtime.robot.demonstrations import Demonstrations, path_of, read
from jiti.runtime.robot.following import Following
from jiti.runtime.robot.keys import Keys
from jiti.runtime.robot.leader import Leader
from jiti.runtime.robot.page import Page
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.recorder import Recorder
from jiti.runtime.robot.recording import TICKS, Recording
from jiti.runtime.robot.request import arm_task
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.scripted import Scripted
from jiti.runtime.robot.settings import VIRTUAL, RobotSettings
from jiti.runtime.robot.stops import Stopped
from jiti.runtime.robot.teller import Say, Teller
from jiti.runtime.robot.virtual import VirtualArm
from jiti.runtime.robot.virtual.demonstrator import check_script
from jiti.runtime.robot.virtual.scenes import EMPTY
from jiti.runtime.workers import alone, remove_leftovers
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig

SECONDS = 60.0
"""Of an episode. Our choice: what the paper's tasks take, four times; a person ends it by Enter."""
QUALITY = 0.5
NONE = "none"
"""As a leader: by hand, whatever the file says."""


@dataclass(frozen=True)
class RecordRequest:
    """The command's arguments; None is for what was not given."""

    settings: RobotSettings
    task: str
    episodes: int = 10
    seconds: float = SECONDS
    seed: int = 0
    """Number of the first episode, and on a virtual arm the seed of its scene."""
    quality: float | None = None
    """Share of the virtual arm's demonstrations that is meant to be elegant."""
    out: Path | None = None


@dataclass(frozen=True)
class Done:
    """What is to be printed."""

    there: Demonstrations
    problem: Exception | None
    """What ended it before its time: Stopped, or an error."""


def record_robot(
    request: RecordRequest, catalogue: Catalogue, say: Say, *, cameras: "dict[str, CameraConfig] | None" = None
) -> Done:
    """Record demonstrations on an arm until `episodes` are there. The arm has no torque afterwards, whatever happened.
    `cameras` are taken instead of those of the settings.

    Raises UsageError for what does not fit together or is missing, RobotError for an arm that cannot begin.
    """
    task, settings = arm_task(request.task, catalogue), _settings(request.settings)
    _check_hand(request, settings, task)
    folder = request.out or Path(f"jiti-{task.task_id.replace('/', '-')}")
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file; it must be a folder, which need not exist yet.")
    paths = {seed: path_of(folder, task.task_id, seed) for seed in range(request.seed, request.seed + request.episodes)}
    about = {"task": task.task_id, "robot": settings.kind}
    make_folder(folder)
    with alone(folder, "jiti record"):
        remove_leftovers(
            folder, [name for path in paths.values() for name in (path.name, path.with_suffix(TICKS).name)]
        )
        kept = {seed for seed, path in paths.items() if read(path, about, kept=True)}
        missing = {seed: path for seed, path in paths.items() if seed not in kept}
        problem, misread = None, 0
        if missing:
            try:
                problem, misread = _record(request, settings, task, missing, about, say, cameras)
            except (RobotError, Stopped) as error:
                if not any(path.exists() for path in missing.values()):
                    raise
                problem = error  # at the end, where an arm is let go
        found = [read(path, about, kept=seed in kept) for seed, path in paths.items()]
        there = [one for one in found if one is not None]
        return Done(Demonstrations(folder, task.task_id, settings.kind, request.episodes, misread, there), problem)


def _record(
    request: RecordRequest,
    settings: RobotSettings,
    task: Task,
    paths: Mapping[int, Path],
    about: Mapping[str, str],
    say: Say,
    cameras: "dict[str, CameraConfig] | None",
) -> tuple[Exception | None, int]:
    """Recordings of seeds; what ended it before the last, and how many exchanges with the arm were tried again."""
    with ExitStack() as stack:
        keys = stack.enter_context(Keys())
        page = stack.enter_context(Page(keys.press))
        tell = Teller(say)
        stack.callback(tell.close)
        tell(f"Open {page.url}")
        panel = Panel(keys, tell, page.show)
        settings, scene, hand = _virtual(request, settings, task, stack)
        leader = stack.enter_context(Leader(settings)) if settings.leader else None
        if scene is not None and cameras is None:
            cameras = scene.cameras()
        arm = stack.enter_context(SafeArm(settings, say=panel.remark, cameras=cameras))
        way = Following(arm, leader) if leader else ByHand(arm)

        def opened(seed: int, manner: str) -> Recording:
            own = {**about, "how": way.how, "seed": str(seed), **({"manner": manner} if manner else {})}
            names = tuple(arm.robot.cameras)
            return Recording(paths[seed], arm.joints, names, instruction=task.instruction, about=own)

        if leader is None:
            panel.remark("The arm has no torque: move it by hand.")
        lay_out = scene.reset if scene else lambda _seed: None
        recorder = Recorder(arm, way, keys, hand, lay_out, panel, paths.__getitem__, opened)
        problem = recorder.record(list(paths), request.seconds)
        page.show(Shown("over", f"It ended: {problem}" if problem else "It is over."))
        return problem, arm.misread


def _virtual(
    request: RecordRequest, settings: RobotSettings, task: Task, stack: ExitStack
) -> tuple[RobotSettings, VirtualArm | None, Scripted | None]:
    """Settings with the ports of arms that are simulated; the one that is to do the task; whose hand demonstrates."""
    if settings.port != VIRTUAL:
        return settings, None, None
    arm = moved = stack.enter_context(VirtualArm(task.task_id, seed=request.seed))
    settings = replace(settings, port=arm.port, id=arm.id, calibration_dir=str(arm.calibration_dir))
    if settings.leader == VIRTUAL:
        moved = stack.enter_context(VirtualArm(EMPTY))
        folder = str(moved.calibration_dir)
        settings = replace(settings, leader=moved.port, leader_id=moved.id, leader_calibration_dir=folder)
    elif settings.leader:
        return settings, arm, None
    return settings, arm, Scripted(arm, moved, QUALITY if request.quality is None else request.quality)


def _settings(settings: RobotSettings) -> RobotSettings:
    """With ports that fit together."""
    if settings.leader == NONE:
        settings = replace(settings, leader="")
    settings.check_port()
    if settings.leader == VIRTUAL != settings.port:
        raise UsageError("--leader virtual is moved by a hand that must see the task's things: pass --port virtual.")
    if (
        settings.leader
        and settings.leader != VIRTUAL
        and Path(settings.leader).resolve() == Path(settings.port).resolve()
    ):
        raise UsageError(f"leader and follower are both at {settings.port}: pass the leader's own port as --leader.")
    return settings


def _check_hand(request: RecordRequest, settings: RobotSettings, task: Task) -> None:
    if settings.port == VIRTUAL and settings.leader in ("", VIRTUAL):
        check_script(task.task_id)
    elif request.quality is not None:
        raise UsageError("--quality is for the hand that demonstrates on a virtual arm: leave it out.")
