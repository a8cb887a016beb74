"""What depends on what: each stage is named by a fingerprint of its inputs and of the stages that it needs.

A stage that is there is never done again, and never stale: with another input it has another fingerprint, and so has
all that needs it. What other inputs made stays where it is.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from jiti.critic.settings_file import RECIPES
from jiti.policies.recipe import recipe_path
from jiti.runtime.benchmark.plan import BenchmarkPlan, Column, Data, Rewards
from jiti.runtime.sim.libero import bddl_fingerprint
from jiti.tasks.catalogue import Catalogue

Kind = Literal["record", "autolabel", "curate", "critics", "values", "policies", "tau", "rollouts"]
"""In the order in which they are done."""
KINDS: tuple[Kind, ...] = ("record", "autolabel", "curate", "critics", "values", "policies", "tau", "rollouts")
REPORT = "report"
"""What comes behind them."""
_VERSION = 1
"""Changes when a stage makes something else of the same inputs."""

Reviewed = Callable[["Stage"], str]
"""A fingerprint of what people decided on the labels of recordings; empty without any."""


@dataclass(frozen=True)
class Stage:
    """One thing to make."""

    kind: Kind
    name: str
    """For folders and people: `elegant-T0`, `filtered-0`."""
    inputs: Mapping[str, Any] = field(hash=False)
    """Whatever it depends on, beside what it needs; JSON."""
    needs: tuple["Stage", ...] = ()

    @cached_property
    def key(self) -> str:
        """Hex digest of all that it depends on."""
        content = [_VERSION, self.kind, self.inputs, [stage.key for stage in self.needs]]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:10]

    @property
    def folder(self) -> str:
        """Name of its folder in that of its kind."""
        return f"{self.name}-{self.key}"

    def needed(self, kind: Kind) -> "Stage":
        """The one of that kind among what it needs."""
        return next(stage for stage in self.needs if stage.kind == kind)


@dataclass(frozen=True)
class Stages:
    """The stages of a plan."""

    plan: BenchmarkPlan
    catalogue: Catalogue
    pack: str
    """Fingerprint of the asset pack."""
    reviewed: Reviewed = lambda _stage: ""
    together: bool = False
    """Whether all methods of a policy and a critic are played in one folder, as `jiti rollout` does."""

    def recordings(self, task: str) -> Stage:
        data = self.plan.data
        inputs: dict[str, Any] = {
            **self._scene(task),
            "episodes": data.episodes,
            "quality": data.quality,
            "seed": data.seed,
        }
        if data.disturbance:  # only then, so that all others keep their keys
            inputs["disturbance"] = data.disturbance
        return Stage("record", _plain(task), inputs)

    def labels(self, task: str) -> Stage:
        return Stage("autolabel", _plain(task), {}, (self.recordings(task),))

    def dataset(self, tasks: Iterable[str]) -> Stage:
        """Of the plan's tasks it is `all`, else `some`."""
        needs = tuple(self.labels(task) for task in tasks)
        curate = self.plan.curate
        inputs = {
            "split": curate.split,
            "seed": curate.seed,
            "gamma": curate.gamma,
            "reviewed": [self.reviewed(stage) for stage in needs],
        }
        return Stage("curate", "all" if tuple(tasks) == self.plan.data.tasks else "some", inputs, needs)

    def values(self) -> Stage:
        """What the critic of segments thinks of the demonstrations that base policies learn from."""
        return Stage("values", "segments", {}, (self.dataset(self.plan.data.tasks), self.critic("segments")))

    def policy(self, data: Data, seed: int) -> Stage:
        plan = self.plan.policy
        inputs = {
            "recipe": plan.recipe,
            "file": _digest(recipe_path(plan.recipe)),
            "steps": plan.steps,
            "seed": seed,
            "data": data,
        }
        needs = (self.dataset(self.plan.data.tasks), *(() if data == "all" else (self.values(),)))
        return Stage("policies", f"{data}-{seed}", inputs, needs)

    def critic(self, rewards: Rewards) -> Stage:
        plan = self.plan.critic
        recipe = RECIPES / f"{plan.recipe}.toml"
        inputs = {
            "recipe": _digest(recipe if recipe.is_file() else Path(plan.recipe)),
            "steps": plan.steps,
            "seed": plan.seed,
            "settings": {section: dict(keys) for section, keys in plan.settings.items()},
            "rewards": rewards,
        }
        return Stage("critics", rewards, inputs, (self.dataset(self.plan.critic_tasks),))

    def tau(self, column: Column, task: str, seed: int) -> Stage:
        """Of a column's policy and critic; of one task where the plan says so."""
        plan = self.plan.tau
        tasks = (task,) if plan.each_task else self.plan.tasks
        inputs = {
            "rate": plan.rate,
            "seed": plan.seed,
            "episodes": plan.episodes,
            "window": self.plan.rollouts.window,
            "most_steps": self.plan.rollouts.most_steps,
            "tasks": [self._scene(one) for one in tasks],
        }
        name = f"{column.data}-{seed}-{column.rewards}" + (f"-{_plain(task)}" if plan.each_task else "")
        return Stage("tau", name, inputs, (self.policy(column.data, seed), self.critic(column.rewards)))

    def rollouts(self, column: Column, task: str, seed: int) -> Stage:
        """Where the rollouts of a cell lie, with those of other picks that have all else in common."""
        plan = self.plan.rollouts
        inputs: dict[str, Any] = {**self._scene(task), "seed": self.plan.seed, "most_steps": plan.most_steps}
        if plan.timing:  # only then, so that all others keep their keys
            inputs["timing"] = True
        needs = (self.policy(column.data, seed),)
        name = f"{column.data}-{seed}"
        method = "together" if self.together else column.method
        if method != "none":
            inputs |= {"method": method, "candidates": plan.candidates, "window": plan.window}
            needs += (self.critic(column.rewards),)
            name += f"-{column.rewards}" + ("" if self.together else f"-{method}")
        if method in ("jiti", "together"):
            inputs["scale"] = column.tau_scale
            needs += (self.tau(column, task, seed),)
            name += "" if column.tau_scale == 1 else f"-x{column.tau_scale:g}"
        return Stage("rollouts", f"{_plain(task)}-{name}", inputs, needs)

    def _scene(self, task: str) -> dict[str, Any]:
        known = self.catalogue.task(task)
        return {
            "task": task,
            "instruction": known.instruction,
            "goals": {itc.itc_id: itc.goal for itc in known.itcs},
            "bddl": known.bddl and bddl_fingerprint(known.bddl),
            "start": self.plan.data.start,
            "assets": self.pack,
            "cameras": list(self.plan.data.cameras),
        }


def in_order(wanted: Iterable[Stage]) -> list[Stage]:
    """These and all that they need, once each, by kind; within one, as they come."""
    found: dict[str, Stage] = {}

    def add(stage: Stage) -> None:
        for needed in stage.needs:
            add(needed)
        found.setdefault(stage.key, stage)

    for stage in wanted:
        add(stage)
    return sorted(found.values(), key=lambda stage: KINDS.index(stage.kind))


def _plain(task: str) -> str:
    return task.replace("/", "-")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
