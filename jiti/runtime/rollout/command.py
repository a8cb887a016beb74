"""`jiti rollout`, whole: from what a user asked for, and what lies in the current folder, to what is printed."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.runtime.guidance import CANDIDATES, WINDOW, Guidance, Pick
from jiti.runtime.rollout.agent import OpenAgent, open_agent
from jiti.runtime.rollout.branch import branch
from jiti.runtime.rollout.find import learned_tasks, newest_critic, newest_policy, newest_task
from jiti.runtime.rollout.live import watch_live
from jiti.runtime.rollout.plan import ROLLOUT_SEED, RolloutPlan, parse_guidance
from jiti.runtime.rollout.plan_file import check_folder, policy_folder
from jiti.runtime.rollout.report import Report
from jiti.runtime.rollout.run import make_out, run_rollouts
from jiti.runtime.rollout.tau import (
    CALIBRATION_EPISODES,
    CALIBRATION_SEED,
    INTERVENTION_RATE,
    Calibration,
    calibrate,
    disjoint_seed,
    save_calibration,
    stored_tau,
    tau_path,
)
from jiti.runtime.sim.env import MOST_STEPS
from jiti.runtime.sim.gl import find_graphics
from jiti.runtime.sim.scene import CAMERAS, Start
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

EPISODES = 50
"""As the paper's cells."""
FOLDER = Path("rollouts")
CALIBRATION_FOLDER, BRANCH_FOLDER = "calibration", "branch"

Say = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """The command's arguments; None is for what was not given."""

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
    episodes: int | None = None
    seed: int | None = None
    start: Start = "jitter"
    assets: str | None = None
    cameras: tuple[str, ...] | None = None
    """None: those that the policy looks at."""
    most_steps: int = MOST_STEPS
    device: str = "cpu"
    workers: int | None = None
    out: Path | None = None
    record: bool = True
    branch: tuple[str, ...] = ()
    live: bool = False

    def check(self) -> None:
        """Raises UsageError for what does not fit together."""
        modes = {
            "--calibrate-tau": self.calibrate_tau is not None,
            "--branch": bool(self.branch),
            "--live": self.live,
        }
        if len(given := [flag for flag, wanted in modes.items() if wanted]) > 1:
            raise UsageError(f"{given[0]} and {given[1]} are two things to do: pass one of them.")
        without = {
            "--guidance": bool(self.guidance),
            "--pick": self.pick != "best",
            "--candidates": self.candidates != CANDIDATES,
            "--tau": self.tau is not None,
            "--tau-scale": self.tau_scale != 1,
        }
        if self.calibrate_tau is not None and (given := [flag for flag, passed in without.items() if passed]):
            raise UsageError(f"--calibrate-tau finds tau on unguided episodes: leave {' and '.join(given)} out.")
        unused = [flag for flag in ("--tau", "--tau-scale") if without[flag]]
        if unused and self.guidance and all(parse_guidance(text)[0] != "jiti" for text in self.guidance):
            raise UsageError(f"no --guidance jiti is asked for: leave {' and '.join(unused)} out.")
        if self.branch and self.guidance:
            raise UsageError("--branch is JITI with several picks: leave --guidance out.")
        if self.branch and self.pick != "best":
            raise UsageError(f"--branch names the picks itself: leave --pick out, or add {self.pick} to --branch.")
        if twice := [pick for pick in self.branch if self.branch.count(pick) > 1]:
            raise UsageError(f"--branch names {twice[0]} twice: each pick is one branch.")
        if not self.tau_scale > 0:
            raise UsageError(f"--tau-scale {self.tau_scale:g} must be above 0")
        if self.live and self.workers not in (None, 1):
            raise UsageError("--live shows one episode at a time: leave --workers out.")


@dataclass(frozen=True)
class Done:
    """What to print."""

    text: str
    content: dict[str, Any]

    def print(self) -> None:
        print(self.text)

    def to_json(self) -> str:
        return json.dumps(self.content, indent=2)


def names(text: str) -> tuple[str, ...]:
    """Of a list with commas; nothing for `none`."""
    return () if text == "none" else tuple(name.strip() for name in text.split(","))


def run_request(
    request: Request,
    catalogue: Catalogue,
    progress: Progress,
    say: Say,
    *,
    here: Path | None = None,
    make_agent: OpenAgent = open_agent,
) -> Report | Done:
    """Do it, and first `say` what was taken. `here` is where what was not named is looked for: the current folder.

    Raises UsageError for what does not fit together or is missing, with the command that makes it.
    """
    request.check()
    plan = _plan(request, catalogue, say, here or Path())
    folder = request.out or FOLDER / plan.task.task_id.replace("/", "-")
    episodes = request.episodes or (EPISODES if request.calibrate_tau is None else CALIBRATION_EPISODES)
    tool = _Tool(request, plan, folder, episodes, progress, say, make_agent)
    if request.calibrate_tau is not None:
        return tool.calibrate_alone(request.calibrate_tau)
    make_out(folder)
    if not request.branch:
        check_folder(folder, plan)  # before tau is calibrated for it
    plan, taken = tool.guided()
    if request.branch:
        if not plan.cameras and request.cameras is None and find_graphics().backend:
            plan = replace(plan, cameras=("front",))
        made = branch(plan, folder / BRANCH_FOLDER, episodes=episodes, progress=progress, make_agent=make_agent)
        return Done(str(made), made.to_json())
    if request.live:
        rollouts = watch_live(plan, folder, episodes=episodes, record=request.record, say=say, make_agent=make_agent)
    else:
        rollouts = run_rollouts(
            plan,
            folder,
            episodes=episodes,
            workers=request.workers,
            record=request.record,
            progress=progress,
            make_agent=make_agent,
        )
    return Report(folder, plan.task.task_id, rollouts, taken)


@dataclass
class _Tool:
    """What the ways through the command share."""

    request: Request
    plan: RolloutPlan
    folder: Path
    episodes: int
    progress: Progress
    say: Say
    make_agent: OpenAgent

    def guided(self) -> tuple[RolloutPlan, dict[str, Any]]:
        """The plan with tau, and what was taken, for `--json`."""
        plan, request = self.plan, self.request
        taken: dict[str, Any] = {
            "policy": plan.policy,
            "critic": plan.critic,
            "seeds": [plan.seed, plan.seed + self.episodes - 1],
            "tau": None,
            "calibration": None,
        }
        if not any(guidance.method == "jiti" for guidance in plan.guidances):
            return plan, taken
        calibration = None
        tau = request.tau
        if tau is None:
            calibration = self._calibration()
            tau = calibration.tau
        tau *= request.tau_scale
        guidances = tuple(replace(g, tau=tau) if g.method == "jiti" else g for g in plan.guidances)
        taken |= {"tau": tau, "tau_scale": request.tau_scale}
        taken |= {"calibration": asdict(calibration) if calibration else None}
        return replace(plan, guidances=guidances), taken

    def calibrate_alone(self, rate: float) -> Done:
        found, path = self._calibrate(rate, self.plan.seed, self.episodes)
        text = (
            f"tau is {found.tau:.4g}: {found.measured:.1%} of {found.decisions} decisions of {found.episodes} unguided "
            f"episodes exceed it, where {rate:.1%} was asked for. It is kept in {path}; `jiti rollout` takes it from "
            "there."
        )
        return Done(text, {**asdict(found), "path": str(path)})

    def _calibration(self) -> Calibration:
        assert self.plan.critic is not None
        path = tau_path(self.plan.critic, self.folder)
        found, why = stored_tau(path, self.plan, window=self.request.window, episodes=self.episodes)
        if found is not None:
            self.say(
                f"tau {found.tau:.4g} from {path}: {found.measured:.1%} of {found.decisions} decisions exceeded it"
            )
            return found
        evaluated = range(self.plan.seed, self.plan.seed + self.episodes)
        seed = disjoint_seed(evaluated, CALIBRATION_EPISODES)
        self.say(
            f"no tau in {path}: {why}. Calibrating it to {INTERVENTION_RATE:.1%} of decisions on "
            f"{CALIBRATION_EPISODES} unguided episodes with seeds {seed} to {seed + CALIBRATION_EPISODES - 1}, none of "
            "which is evaluated"
        )
        found, path = self._calibrate(INTERVENTION_RATE, seed, CALIBRATION_EPISODES)
        self.say(
            f"tau is {found.tau:.4g}, kept in {path}: {found.measured:.1%} of {found.decisions} decisions exceed it"
        )
        return found

    def _calibrate(self, rate: float, seed: int, episodes: int) -> tuple[Calibration, Path]:
        plan = replace(self.plan, seed=seed)
        # A folder for each start and length: a wider or longer calibration does not disturb one that is there.
        folder = self.folder / CALIBRATION_FOLDER / f"{seed}-k{self.request.window}-{plan.most_steps}"
        found = calibrate(
            [plan],
            folder,
            rate=rate,
            window=self.request.window,
            episodes=episodes,
            workers=self.request.workers,
            progress=self.progress,
            make_agent=self.make_agent,
        )
        assert plan.critic is not None
        path = tau_path(plan.critic, self.folder)
        save_calibration(path, found)
        return found, path


def _plan(request: Request, catalogue: Catalogue, say: Say, here: Path) -> RolloutPlan:
    """The plan, without tau where that is not given. Raises UsageError for what is missing."""
    task = _task(request, catalogue, say, here)
    policy = request.policy
    if policy is None:
        found = newest_policy(here)
        if found is None:
            raise UsageError(
                f"no policy of lerobot was found under {_shown(here)}. Pass --policy FOLDER, or train one: `jiti "
                "curate --out dataset`, then `lerobot-train` as docs/policies.md says."
            )
        policy = str(found)
        say(f"policy {_shown(found, here)}, the newest under {_shown(here)}")
    guidances = _guidances(request)
    critic = request.critic
    if critic is None and (request.calibrate_tau is not None or any(g.method != "none" for g in guidances)):
        found = newest_critic(here)
        if found is None:
            raise UsageError(
                f"no critic was found under {_shown(here)}. Pass --critic RUN, train one with `jiti train-critic "
                "DATASET --out critic`, or pass --guidance none."
            )
        critic = str(found)
        say(f"critic {_shown(found, here)}, the newest under {_shown(here)}")
    if critic is not None and (learned := learned_tasks(critic)) and task.task_id not in learned:
        say(f"note: the critic learned from {', '.join(learned)}, and not from {task.task_id}")
    seed = request.seed
    if seed is None:
        seed = ROLLOUT_SEED if request.calibrate_tau is None else CALIBRATION_SEED
    return RolloutPlan(
        task,
        policy,
        critic,
        guidances,
        seed,
        request.start,
        request.assets,
        _cameras(policy) if request.cameras is None else request.cameras,
        request.most_steps,
        request.device,
    )


def _cameras(policy: str) -> tuple[str, ...]:
    """All, where a policy looks at pictures; else none, which is several times faster. Raises UsageError for a policy
    whose configuration cannot be read."""
    path = policy_folder(policy) / "config.json"
    try:
        seen = json.loads(path.read_bytes()).get("input_features") or {}
        looks = any(key.startswith("observation.image") for key in seen)
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise UsageError(
            f"{path} is damaged: {error}. Copy the checkpoint anew, train it again, or pass another --policy."
        ) from error
    return tuple(CAMERAS) if looks else ()


def _task(request: Request, catalogue: Catalogue, say: Say, here: Path) -> Task:
    if request.task is not None:
        return catalogue.simulated(request.task)
    found = newest_task(here, catalogue)
    if found is None:
        raise UsageError(
            f"no recording of a task of simulation was found under {_shown(here)}. Pass --task elegant/T2, or make "
            "some: `jiti record --task elegant/T2`."
        )
    task, path = found
    say(f"task {task.task_id}, as the newest recording under {_shown(here)} has it: {_shown(path, here)}")
    return task


def _guidances(request: Request) -> tuple[Guidance, ...]:
    """With tau at infinity where it is not known yet."""
    if request.calibrate_tau is not None:
        wanted: Sequence[tuple[Any, Any]] = [("jiti", "best")]
    elif request.branch:
        wanted = [parse_guidance(f"jiti:{pick}") for pick in request.branch]
    else:
        # An ESR alone says nothing: by default the base policy is beside it.
        wanted = [parse_guidance(text, request.pick) for text in request.guidance or ("none", "jiti")]
    tau = float("inf") if request.tau is None else request.tau
    return tuple(
        Guidance(method, pick, request.candidates, request.window, tau if method == "jiti" else None)
        for method, pick in wanted
    )


def _shown(path: Path, here: Path | None = None) -> str:
    """A path as a person would type it."""
    if here is not None and path.is_relative_to(here):
        path = path.relative_to(here)
    return "the current folder" if path == Path() else str(path)
