"""What to play: a task, a policy, a critic, and which ways of guiding it start from the same states."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, get_args

from jiti.errors import UsageError
from jiti.runtime.guidance import Guidance, Method, Pick
from jiti.runtime.sim.env import MOST_STEPS
from jiti.runtime.sim.libero import bddl_fingerprint, pack_fingerprint, pack_name
from jiti.runtime.sim.scene import CAMERAS, CONTROL_HZ, Start
from jiti.tasks.task import Task

ROLLOUT_SEED = 100_000
"""Of the first episode. Our choice: far from the seeds of demonstrations, which `jiti record` counts from 0."""


def label_of(guidance: Guidance) -> str:
    """What a way of guiding is called in folders and tables: `none`, `jiti`, `full`, `jiti-random`."""
    return guidance.method if guidance.pick == "best" else f"{guidance.method}-{guidance.pick}"


def parse_guidance(text: str, pick: Pick = "best") -> tuple[Method, Pick]:
    """`METHOD` or `METHOD:PICK`. Raises UsageError that names what there is."""
    method, _, own = text.partition(":")
    chosen: Any = own or ("best" if method == "none" else pick)
    for value, known, flag in ((method, get_args(Method), "--guidance"), (chosen, get_args(Pick), "--pick")):
        if value not in known:
            raise UsageError(f"{flag} {value}: there are {', '.join(known)}, and both as in --guidance jiti:random.")
    if method == "none" and chosen != "best":
        raise UsageError(f"--guidance {text}: without guidance there is nothing to pick from. Pass --guidance none.")
    found: Any = method
    return found, chosen


@dataclass(frozen=True)
class RolloutPlan:
    """Episode k of a plan has the same initial state and noise for every way of guiding, and is the same whatever else
    is played with it."""

    task: Task
    policy: str
    """Folder of a checkpoint or of a run of lerobot-train, or Hub id."""
    critic: str | None = None
    """Folder or Hub id; needed by every method but `none`."""
    guidances: tuple[Guidance, ...] = (Guidance("none"),)
    seed: int = ROLLOUT_SEED
    """Of the first episode; episode k has seed + k, for the scene and for the noise of chunks."""
    start: Start = "jitter"
    assets: str | None = None
    """Asset pack: a folder, "primitive" (the default) or "libero"."""
    cameras: tuple[str, ...] = ()
    """Rendered for the policy and recorded."""
    most_steps: int = MOST_STEPS
    """After which an episode is cut off."""
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise UsageError(f"--seed {self.seed} is negative; give 0 or more")
        if self.most_steps < 1:
            raise UsageError(f"episodes of {self.most_steps} steps; give --max-steps 1 or more")
        if self.task.bddl is None:
            raise UsageError(f"{self.task.task_id} is not a task of simulation; `jiti tasks` lists all")
        if not self.task.itcs:
            raise UsageError(
                f"{self.task.task_id} has no ITC, so nothing would tell an elegant rollout from a successful one. Add "
                "one to its task file and pass that with --tasks."
            )
        if unjudged := [itc.itc_id for itc in self.task.itcs if not itc.goal]:
            raise UsageError(
                f"{unjudged[0]} has no `goal`, so the simulator cannot decide it; add one to its task file"
            )
        for camera in self.cameras:
            if camera not in CAMERAS:
                raise UsageError(f"there is no camera {camera!r}; there are: {', '.join(CAMERAS)}, or none")
        if not self.guidances:
            raise UsageError("no guidance was asked for; pass --guidance none, jiti or full")
        if twice := [label for label in self.labels if self.labels.count(label) > 1]:
            raise UsageError(f"--guidance {twice[0]} is asked for twice")
        if self.critic is None and (asking := [g.method for g in self.guidances if g.method != "none"]):
            raise UsageError(
                f"--guidance {asking[0]} needs a critic: pass --critic RUN. `jiti train-critic DATASET --out RUN` "
                "makes one."
            )

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the guidances, in their order."""
        return tuple(label_of(guidance) for guidance in self.guidances)

    def guidance(self, label: str) -> Guidance:
        """The guidance of that name."""
        return self.guidances[self.labels.index(label)]

    def stem(self, number: int) -> str:
        """Name of episode `number`'s files, which are in a folder for each guidance."""
        return f"{self.task.task_id.replace('/', '-')}_{self.seed + number:04d}"

    def shared(self) -> dict[str, Any]:
        """What all rollouts of a folder must have in common, beside the policy's weights. Raises UsageError where the
        scene's files are not there."""
        assert self.task.bddl is not None
        return {
            "task": self.task.task_id,
            "instruction": self.task.instruction,
            "goals": {itc.itc_id: itc.goal for itc in self.task.itcs},
            "seed": self.seed,
            "start": self.start,
            "bddl": bddl_fingerprint(self.task.bddl),
            "assets": pack_name(self.assets),
            "pack": pack_fingerprint(self.assets),
            "cameras": list(self.cameras),
            "most_steps": self.most_steps,
            "rate_hz": CONTROL_HZ,
            "device": self.device,  # whose sums differ in the last digits
        }


def settings_of(guidance: Guidance, critic: str | None) -> dict[str, Any]:
    """What a guidance does, with the critic's fingerprint: whatever its rollouts depend on."""
    if guidance.method == "none":
        return {"method": "none"}
    settings: dict[str, Any] = {"method": guidance.method, "pick": guidance.pick, "critic": critic}
    settings |= {"candidates": guidance.candidates, "window": guidance.window}
    if guidance.method == "jiti":
        settings["tau"] = "inf" if guidance.tau == float("inf") else guidance.tau
    return settings
