"""What is to be played on an arm: a user's arguments, and what follows from them before anything is opened."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from jiti.errors import UsageError
from jiti.runtime.guidance import CANDIDATES, WINDOW, Guidance, Pick
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.tau import Asked, stored_tau
from jiti.runtime.robot.turn import Turn
from jiti.runtime.rollout.plan import label_of, parse_guidance, settings_of
from jiti.runtime.rollout.plan_file import critic_folder, fingerprint, policy_folder
from jiti.runtime.rollout.result import RECORDING_SUFFIX
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

FOLDER = Path("rollouts")
SECONDS = 30.0
"""Of an episode. Our choice: what the paper's tasks take, twice."""
EVALUATED = 20
"""Layouts of an evaluation. Our choice: an hour for two guidances; Wilson's interval is then 40 points wide."""
CALIBRATED = 5
"""Episodes that tau is measured on. Our choice: some 200 decisions of SmolVLA, which place the rate to 4 points."""
CALIBRATION = "calibration"
"""Folder of their recordings."""


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
    calibrate_tau: float | None = None
    """The share of decisions that is to trigger: episodes are played in which nothing is done, and tau follows."""
    episodes: int | None = None
    seconds: float = SECONDS
    seed: int | None = None
    device: str = "cpu"
    out: Path | None = None
    record: bool = True
    dry_run: bool = False
    live: bool = False
    judge: bool = False
    """A person says after each episode what it was like; several guidances are compared so."""
    blind: bool = True
    """Without being told which guidance it was."""


def task_of(request: RobotRequest, catalogue: Catalogue) -> Task:
    if request.task is None:
        raise UsageError("which task? Pass --task so100/T4; `jiti tasks` lists all, --tasks adds your own.")
    return arm_task(request.task, catalogue)


def arm_task(name: str, catalogue: Catalogue) -> Task:
    """`T4` is the arm's, whatever else is called so. Raises CatalogueError for one that is not there."""
    short = f"so100/{name}"
    return catalogue.task(short if any(task.task_id == short for task in catalogue.tasks) else name)


def folder_of(request: RobotRequest, task: Task) -> Path:
    """Of a task's rollouts."""
    return request.out or FOLDER / task.task_id.replace("/", "-")


def taken_of(request: RobotRequest, guidances: tuple[Guidance, ...]) -> dict[str, Any]:
    """What a report says of how it came about."""
    taken: dict[str, Any] = {"policy": request.policy, "critic": request.critic, "settings": asdict(request.settings)}
    tau = next((guidance.tau for guidance in guidances if guidance.method == "jiti"), None)
    return taken | {"guidance": ", ".join(map(label_of, guidances)), "tau": tau, "dry_run": request.dry_run}


def shared_of(request: RobotRequest, task: Task, guidances: tuple[Guidance, ...]) -> dict[str, Any]:
    """What all episodes of an evaluation have in common."""
    shared: dict[str, Any] = {"task": task.task_id, "robot": request.settings.kind, "seconds": request.seconds}
    shared |= {name: getattr(request.settings, name) for name in ("fps", "execute", "max_step")}
    shared |= {"policy": _identity_of_policy(request), "itcs": [itc.itc_id for itc in task.itcs]}
    for guidance in guidances:
        shared[f"guidance {label_of(guidance)}"] = settings_of(guidance, _identity_of_critic(request))
    return shared | {"guidances": sorted(map(label_of, guidances))}


def asked_of(request: RobotRequest, task: Task) -> Asked:
    """What a tau of these rollouts is for."""
    policy, critic = _identity_of_policy(request), _identity_of_critic(request)
    return Asked(task.task_id, request.settings.kind, policy, critic, request.window)


def turns_of(request: RobotRequest, folder: Path, task: Task, guidance: Guidance) -> list[Turn]:
    """Without a first seed they go on behind those there. Raises UsageError where one would take another's place."""
    calibrating = request.calibrate_tau is not None
    stem, folder = task.task_id.replace("/", "-"), folder / (CALIBRATION if calibrating else label_of(guidance))
    there = [int(one.stem.rpartition("_")[2]) for one in folder.glob(f"{stem}_[0-9]*{RECORDING_SUFFIX}")]
    first = max(there, default=-1) + 1 if request.seed is None else request.seed
    seeds = range(first, first + (request.episodes or (CALIBRATED if calibrating else 1)))
    turns = [Turn(seed, seed, guidance, folder / f"{stem}_{seed:04d}{RECORDING_SUFFIX}") for seed in seeds]
    if request.record and (taken := [turn.path for turn in turns if turn.number in there]):
        raise UsageError(f"{taken[0]} is there already: leave --seed out, or pass another --out.")
    return turns


def layouts_of(request: RobotRequest) -> int:
    """Of the table, each of which every guidance plays."""
    return request.episodes or EVALUATED


def guidances_of(request: RobotRequest, task: Task, folder: Path) -> tuple[Guidance, ...]:
    """Raises UsageError for what does not fit together, or lacks a critic or a threshold."""
    _check(request)
    if request.calibrate_tau is not None:  # the critic is asked, and nothing is done about it
        return (Guidance("jiti", candidates=request.candidates, window=request.window, tau=float("inf")),)
    wanted = list(request.guidance) or ["jiti" if request.critic else "none"]
    if len(wanted) > 1 and not request.judge:
        raise UsageError(
            "an arm plays one guidance at a time, and a person compares several: add --judge, or pass one --guidance."
        )
    found = []
    for method, pick in (parse_guidance(one, request.pick) for one in wanted):
        if method != "none" and request.critic is None:
            raise UsageError(f"--guidance {method} needs a critic: pass --critic RUN.")
        tau = None
        if method == "jiti":
            tau = request.tau_scale * (
                stored_tau(folder, asked_of(request, task)) if request.tau is None else request.tau
            )
        found.append(Guidance(method, pick, request.candidates, request.window, tau))
    labels = [label_of(guidance) for guidance in found]
    if twice := [label for label in labels if labels.count(label) > 1]:
        raise UsageError(f"--guidance {twice[0]} is asked for twice.")
    return tuple(found)


def _check(request: RobotRequest) -> None:
    """Raises UsageError for what does not go together."""
    if request.judge and not request.record:
        raise UsageError("what is judged is recorded, on an arm that moves: leave --no-record and --dry-run out.")
    if request.judge and request.seed is not None:
        raise UsageError("an evaluation numbers its layouts from 0: leave --seed out.")
    if request.calibrate_tau is None:
        return
    if request.critic is None:
        raise UsageError("tau is a threshold on a critic's values: pass --critic RUN.")
    if not 0 < request.calibrate_tau < 1:
        raise UsageError(f"--calibrate-tau {request.calibrate_tau:g}: a share between 0 and 1; the paper's is 0.339.")
    guided = request.guidance or request.tau is not None or request.tau_scale != 1 or request.pick != "best"
    if guided or request.candidates != CANDIDATES or request.judge or not request.record:
        raise UsageError(
            "--calibrate-tau plays and records episodes in which nothing is done: leave --guidance, --tau, "
            "--tau-scale, --pick, --candidates, --judge, --dry-run and --no-record out."
        )


def _identity_of_policy(request: RobotRequest) -> str:
    return _identity(request.policy, policy_folder, "policy")


def _identity_of_critic(request: RobotRequest) -> str:
    return _identity(request.critic, critic_folder, "critic")


def _identity(name: str | None, find: Callable[[str], Path], what: str) -> str:
    """Of a policy or a critic: its weights', so that others in its place are known; a Hub id as it is. Raises
    UsageError for one that is nowhere."""
    if name is None:
        return ""
    if Path(name).expanduser().is_dir():
        return fingerprint(find(name))
    if "/" not in name:
        raise UsageError(f"there is no {what} {name!r} here; pass the folder of a run or checkpoint, or a Hub id.")
    return name
