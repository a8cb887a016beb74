"""tau without hand tuning: the threshold that a wished share of decisions exceeds in unguided episodes of their own.

It is kept with the critic, in `tau.json`, with all that it depends on, and is taken only where that is the same.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from jiti.durable import write_atomic
from jiti.errors import SourceError, UsageError
from jiti.progress import Progress
from jiti.runtime.guidance import Guidance, calibrated_tau
from jiti.runtime.rollout.agent import OpenAgent, open_agent
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.runtime.rollout.plan_file import TAU_FILE, critic_folder, fingerprint, policy_folder
from jiti.runtime.rollout.result import Rollout
from jiti.runtime.rollout.run import run_rollouts
from jiti.runtime.sim.libero import bddl_fingerprint, pack_fingerprint

INTERVENTION_RATE = 0.339
"""Share of decisions that are to trigger; supplement G.6."""
CALIBRATION_SEED = 200_000
"""Of the first episode of calibration. Our choice: away from those of demonstrations and rollouts."""
CALIBRATION_EPISODES = 20
"""Our choice: some 400 decisions, which place the rate to about 3 points."""
_VERSION = 2
"""2: with the share measured, most steps and cameras, without which none is taken."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A tau, and what it was measured on."""

    tau: float
    rate: float
    """Share of decisions that was to exceed it."""
    measured: float
    """Share of these decisions that did: delta_q > tau."""
    window: int
    """k"""
    policy: str
    """Fingerprint, as in `plan.json`."""
    critic: str
    tasks: tuple[str, ...]
    start: str
    assets: str
    """Fingerprint of the asset pack."""
    cameras: tuple[str, ...]
    """Rendered; without any, neither policy nor critic looked at pictures."""
    most_steps: int
    """After which an episode was cut off."""
    seeds: tuple[int, int]
    """First, and the one after the last, of each task."""
    episodes: int
    """Of all tasks."""
    decisions: int
    made: str = ""
    """When, in UTC."""
    bddl: tuple[str, ...] = ()
    """Fingerprints of the tasks' problem files; none where an older jiti calibrated."""

    def unlike(self, plan: RolloutPlan, window: int, policy: str, critic: str, episodes: int) -> str:
        """Why this is not for the rollouts of a plan; empty where it is."""
        wanted = {"window": window, "policy": policy, "critic": critic}
        wanted |= {"start": plan.start, "assets": pack_fingerprint(plan.assets), "most_steps": plan.most_steps}
        for name, value in wanted.items():
            if getattr(self, name) != value:
                return f"it was calibrated with {name} {getattr(self, name)} and not {value}"
        if self.cameras and self.cameras != plan.cameras:
            return (
                f"it was calibrated with cameras {', '.join(self.cameras)} and not {', '.join(plan.cameras) or 'none'}"
            )
        if plan.task.task_id not in self.tasks:
            return f"it was calibrated on {', '.join(self.tasks)}"
        assert plan.task.bddl is not None
        scene = bddl_fingerprint(plan.task.bddl)
        if scene not in self.bddl:
            return f"it was calibrated in {', '.join(self.bddl) or 'an unknown scene'} and not {scene}"
        if max(self.seeds[0], plan.seed) < min(self.seeds[1], plan.seed + episodes):
            return f"its seeds {self.seeds[0]} to {self.seeds[1] - 1} are among those that are to be evaluated"
        return ""


def looking(plan: RolloutPlan, window: int) -> RolloutPlan:
    """The plan's unguided episodes, in which the critic values the default chunk: tau is infinite, so it is asked and
    nothing is done about it."""
    return replace(plan, guidances=(Guidance("jiti", window=window, tau=float("inf")),))


def looking_folder(folder: Path, plan: RolloutPlan) -> Path:
    """Where these episodes lie in the folder of a calibration of several tasks."""
    return folder / plan.task.task_id.replace("/", "-")


def calibrate(
    plans: Sequence[RolloutPlan],
    folder: Path,
    *,
    rate: float = INTERVENTION_RATE,
    window: int,
    episodes: int = CALIBRATION_EPISODES,
    workers: int | None = None,
    progress: Progress | None = None,
    make_agent: OpenAgent = open_agent,
) -> Calibration:
    """Play `episodes` unguided episodes of each plan in `folder`, in which the critic values the default chunk, and
    take the tau that the share `rate` of all their decisions exceeds. Plans differ in the task alone; their guidances
    are not used, their seeds are. A stopped run goes on. The calibration is not saved.

    Raises UsageError for a rate outside 0 to 1, or plans without a critic.
    """
    if not 0 < rate < 1:
        raise UsageError(f"an intervention rate of {rate}; it must be between 0 and 1. The paper's is 0.339 (G.6).")
    if any(plan.critic is None for plan in plans):
        raise UsageError("tau is a threshold on a critic's values: pass --critic RUN.")
    report = progress or (lambda _share, _what: None)
    played: list[Rollout] = []
    for place, plan in enumerate(plans):

        def part(share: float, what: str, place: int = place) -> None:
            report((place + share) / len(plans), f"calibrating tau: {what}")

        played += run_rollouts(
            looking(plan, window),
            looking_folder(folder, plan),
            episodes=episodes,
            workers=workers,
            record=False,
            progress=part,
            make_agent=make_agent,
        )
    first = plans[0]
    assert first.critic is not None
    delta_q = np.array([choice.delta_q for rollout in played for choice in rollout.choices])
    tau = calibrated_tau(delta_q, rate)
    return Calibration(
        tau,
        rate,
        float(np.mean(delta_q > tau)),
        window,
        fingerprint(policy_folder(first.policy)),
        fingerprint(critic_folder(first.critic)),
        tuple(plan.task.task_id for plan in plans),
        first.start,
        pack_fingerprint(first.assets),
        first.cameras,
        first.most_steps,
        (first.seed, first.seed + episodes),
        len(played),
        len(delta_q),
        datetime.now(UTC).isoformat(timespec="seconds"),
        tuple(bddl_fingerprint(plan.task.bddl) for plan in plans if plan.task.bddl is not None),
    )


def disjoint_seed(evaluated: range, episodes: int) -> int:
    """A first seed for calibration such that none of its episodes is evaluated."""
    free = evaluated.stop <= CALIBRATION_SEED or evaluated.start >= CALIBRATION_SEED + episodes
    return CALIBRATION_SEED if free else evaluated.stop


def tau_path(critic: str, otherwise: Path) -> Path:
    """Where tau is kept: with the critic, or in a folder of rollouts where the critic is on the Hub or read-only."""
    folder = Path(critic).expanduser()
    return (folder if folder.is_dir() and os.access(folder, os.W_OK) else otherwise) / TAU_FILE


def save_calibration(path: Path, found: Calibration) -> None:
    """Keep a calibration, in the place of one with the same rate, window, policy, tasks, starts, cameras and length.

    Those of another critic are dropped: weights that stood here before. Raises SaveFailed.
    """

    def key(one: Calibration) -> tuple[Any, ...]:
        played = (one.tasks, one.bddl, one.start, one.assets, one.cameras, one.most_steps)
        return (one.rate, one.window, one.policy, one.critic, *played)

    kept = [one for one in load_calibrations(path) if one.critic == found.critic and key(one) != key(found)]
    content = {"version": _VERSION, "calibrations": [asdict(one) for one in (*kept, found)]}
    write_atomic(path, json.dumps(content, indent=2).encode())


def load_calibrations(path: Path) -> list[Calibration]:
    """The oldest first; none where there is no file, or one of an older version, which does not say what tau depends
    on. Raises SourceError for a file of something else."""
    if not path.exists():
        return []
    try:
        content = json.loads(path.read_bytes())
        if content["version"] < _VERSION:
            return []
        if content["version"] > _VERSION:
            raise ValueError(f"version {content['version']}; this jiti reads {_VERSION}")
        return [
            Calibration(
                **row | {name: tuple(row[name]) for name in ("tasks", "cameras", "seeds", "bddl") if name in row}
            )
            for row in content["calibrations"]
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path} is damaged: {error!r}. Delete it, and tau is calibrated anew.") from error


def stored_tau(path: Path, plan: RolloutPlan, *, window: int, episodes: int) -> tuple[Calibration | None, str]:
    """The newest calibration that is for the rollouts of a plan; else None, and why the newest is not."""
    assert plan.critic is not None
    policy, critic = fingerprint(policy_folder(plan.policy)), fingerprint(critic_folder(plan.critic))
    why = "there is none yet"
    for one in reversed(load_calibrations(path)):
        unlike = one.unlike(plan, window, policy, critic, episodes)
        if not unlike:
            return one, ""
        why = unlike if why == "there is none yet" else why
    return None, why
