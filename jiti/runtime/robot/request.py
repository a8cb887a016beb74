"""What is to be played on an arm: a user's arguments, and what follows from them before anything is opened."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from jiti.errors import UsageError
from jiti.runtime.guidance import CANDIDATES, WINDOW, Guidance, Method, Pick
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.turn import Turn
from jiti.runtime.rollout.plan import label_of, parse_guidance, settings_of
from jiti.runtime.rollout.plan_file import fingerprint
from jiti.runtime.rollout.result import RECORDING_SUFFIX
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

FOLDER = Path("rollouts")
SECONDS = 30.0
"""Of an episode. Our choice: what the paper's tasks take, twice."""
EVALUATED = 20
"""Layouts of an evaluation. Our choice: an hour for two guidances; Wilson's interval is then 40 points wide."""


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
    judge: bool = False
    """A person says after each episode what it was like; several guidances are compared so."""
    blind: bool = True
    """Without being told which guidance it was."""


def task_of(request: RobotRequest, catalogue: Catalogue) -> Task:
    if request.task is None:
        raise UsageError("which task? Pass --task so100/T4; `jiti tasks` lists all, --tasks adds your own.")
    return catalogue.task(request.task)


def taken_of(request: RobotRequest, guidances: tuple[Guidance, ...]) -> dict[str, Any]:
    taken: dict[str, Any] = {"policy": request.policy, "critic": request.critic, "settings": asdict(request.settings)}
    taken |= {"guidance": ", ".join(map(label_of, guidances)), "tau": _tau(request), "dry_run": request.dry_run}
    return taken


def shared_of(request: RobotRequest, task: Task, guidances: tuple[Guidance, ...]) -> dict[str, Any]:
    """What all episodes of an evaluation have in common."""

    def known(name: str | None) -> str | None:
        folder = Path(name).expanduser() if name else None
        return fingerprint(folder) if folder and folder.is_dir() else name

    shared: dict[str, Any] = {"task": task.task_id, "robot": request.settings.kind, "seconds": request.seconds}
    shared |= {"policy": known(request.policy), "itcs": [itc.itc_id for itc in task.itcs]}
    for guidance in guidances:
        shared[f"guidance {label_of(guidance)}"] = settings_of(guidance, known(request.critic))
    return shared | {"guidances": sorted(map(label_of, guidances))}


def turns_of(request: RobotRequest, folder: Path, task: Task, guidance: Guidance) -> list[Turn]:
    """Without a first seed they go on behind those there. Raises UsageError where one would take another's place."""
    stem, folder = task.task_id.replace("/", "-"), folder / label_of(guidance)
    there = [int(one.stem.rpartition("_")[2]) for one in folder.glob(f"{stem}_[0-9]*{RECORDING_SUFFIX}")]
    first = max(there, default=-1) + 1 if request.seed is None else request.seed
    seeds = range(first, first + (request.episodes or 1))
    turns = [Turn(seed, seed, guidance, folder / f"{stem}_{seed:04d}{RECORDING_SUFFIX}") for seed in seeds]
    if request.record and (taken := [turn.path for turn in turns if turn.number in there]):
        raise UsageError(f"{taken[0]} is there already: leave --seed out, or pass another --out.")
    return turns


def layouts_of(request: RobotRequest) -> int:
    """Of the table, each of which every guidance plays."""
    return request.episodes or EVALUATED


def guidances_of(request: RobotRequest) -> tuple[Guidance, ...]:
    """Raises UsageError for what does not fit together, or lacks a critic or a threshold."""
    wanted = list(request.guidance) or ["jiti" if request.critic else "none"]
    if len(wanted) > 1 and not request.judge:
        raise UsageError(
            "an arm plays one guidance at a time, and a person compares several: add --judge, or pass one --guidance."
        )
    if request.judge and not request.record:
        raise UsageError("what is judged is recorded, on an arm that moves: leave --no-record and --dry-run out.")
    if request.judge and request.seed is not None:
        raise UsageError("an evaluation numbers its layouts from 0: leave --seed out.")
    found = [_guidance(request, *parse_guidance(one, request.pick)) for one in wanted]
    labels = [label_of(guidance) for guidance in found]
    if twice := [label for label in labels if labels.count(label) > 1]:
        raise UsageError(f"--guidance {twice[0]} is asked for twice.")
    return tuple(found)


def _guidance(request: RobotRequest, method: Method, pick: Pick) -> Guidance:
    if method != "none" and request.critic is None:
        raise UsageError(f"--guidance {method} needs a critic: pass --critic RUN.")
    tau = None
    if method == "jiti":
        tau = _tau(request)
        if tau is None:
            raise UsageError(
                "JITI needs a threshold: pass --tau. Play some episodes with --tau inf first: delta_q in their "
                ".decisions.parquet says what jumps there are, of which a third is to be above tau (G.6)."
            )
    return Guidance(method, pick, request.candidates, request.window, tau)


def _tau(request: RobotRequest) -> float | None:
    return None if request.tau is None else request.tau * request.tau_scale
