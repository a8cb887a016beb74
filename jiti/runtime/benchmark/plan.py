"""What a benchmark does, all of it fixed before the run: data, training, tau, the columns and who is compared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from jiti.curate.export.split import parse_shares
from jiti.errors import UsageError
from jiti.policies.recipe import RECIPES
from jiti.runtime.guidance import CANDIDATES, WINDOW, Method, Pick
from jiti.runtime.sim.env import MOST_STEPS
from jiti.runtime.sim.scene import CAMERAS, Start

Data = Literal["all", "filtered", "weighted"]
"""What a base policy learns from: every demonstration, or what the critic of segments makes of them (supplement G.3):
the half that it values most (Filtered Data), or all with its weights (Weighted Data)."""
Rewards = Literal["segments", "sparse"]
"""What a critic learns from: the labelled segments, or 1 at the end of an episode that succeeded."""


@dataclass(frozen=True, slots=True)
class DataPlan:
    """Demonstrations."""

    tasks: tuple[str, ...]
    """Full ids of the tasks that the base policies learn."""
    episodes: int = 40
    """Of each task."""
    quality: float = 0.5
    """Share that is meant to be elegant."""
    disturbance: float = 0.0
    """Of the strongest push on the demonstrator's hand, in the unit of an action."""
    seed: int = 0
    """Of the first episode of each task."""
    start: Start = "jitter"
    assets: str = "primitive"
    cameras: tuple[str, ...] = ()
    """Rendered in recordings and rollouts, for policies that look; none is several times faster."""

    def __post_init__(self) -> None:
        if not self.tasks:
            raise UsageError("data.tasks is empty; name at least one task")
        _different("data.tasks", self.tasks)
        _different("data.cameras", self.cameras)
        _at_least("data.episodes", self.episodes, 1)
        _at_least("data.seed", self.seed, 0)
        _one_of("data.start", self.start, get_args(Start))
        for camera in self.cameras:
            _one_of("data.cameras", camera, tuple(CAMERAS))
        if not 0 <= self.quality <= 1:
            raise UsageError(f"data.quality is {self.quality}; it must be from 0 to 1")
        if not 0 <= self.disturbance <= 1:
            raise UsageError(f"data.disturbance is {self.disturbance}; it must be from 0 to 1")


@dataclass(frozen=True, slots=True)
class CuratePlan:
    """Options of `jiti curate`."""

    split: str = "0.8,0.1,0.1"
    """Which the critic keeps to; base policies learn from all of it, for they are judged on other seeds."""
    seed: int = 0
    gamma: float = 0.98

    def __post_init__(self) -> None:
        _at_least("curate.seed", self.seed, 0)
        if not 0 <= self.gamma <= 1:
            raise UsageError(f"curate.gamma is {self.gamma}; it must be from 0 to 1")
        try:
            parse_shares(self.split)
        except UsageError as error:
            raise UsageError(
                f"curate.split is {self.split!r}; it must be three shares of train, validation and test that sum to 1, "
                "the first above 0: '0.8,0.1,0.1'"
            ) from error


@dataclass(frozen=True, slots=True)
class PolicyPlan:
    """Base policies."""

    recipe: str = "state_flow"
    steps: int = 30_000

    def __post_init__(self) -> None:
        _one_of("policy.recipe", self.recipe, tuple(RECIPES))
        _at_least("policy.steps", self.steps, 1)


@dataclass(frozen=True, slots=True)
class CriticPlan:
    """Critics."""

    recipe: str = "state"
    """As `jiti train-critic --config` takes it: the name of a recipe, or a TOML file."""
    steps: int = 6000
    seed: int = 0
    tasks: tuple[str, ...] = ()
    """What it learns from; empty: all of `data.tasks`."""
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """What differs from the recipe, by section, as in its TOML file."""

    def __post_init__(self) -> None:
        _at_least("critic.steps", self.steps, 1)
        _at_least("critic.seed", self.seed, 0)
        _different("critic.tasks", self.tasks)


@dataclass(frozen=True, slots=True)
class TauPlan:
    """How tau is found, for each policy with each critic."""

    rate: float = 0.339
    """Share of decisions that exceed it; supplement G.6."""
    seed: int = 200_000
    episodes: int = 5
    """Of each task, unguided, with seeds of their own."""
    each_task: bool = False
    """A tau for each task, and not one for all."""

    def __post_init__(self) -> None:
        _at_least("tau.episodes", self.episodes, 1)
        _at_least("tau.seed", self.seed, 0)
        if not 0 < self.rate < 1:
            raise UsageError(f"tau.rate is {self.rate}; it must be between 0 and 1")


@dataclass(frozen=True, slots=True)
class RolloutsPlan:
    """What every cell plays."""

    tasks: tuple[str, ...] = ()
    """Full ids; empty: all of `data.tasks`."""
    seed: int = 100_000
    """Of the first episode of each task, the same for every column."""
    episodes: int = 50
    """A cell; the paper's number."""
    tuning_seed: int = 300_000
    tuning_episodes: int = 10
    """What `--tuning` plays in their place, so that no choice is made on the states that are reported."""
    candidates: int = CANDIDATES
    window: int = WINDOW
    most_steps: int = MOST_STEPS
    device: str = "cpu"
    """Of policy and critic."""
    timing: bool = False
    """Whether times are what is asked: rollouts are then played for that alone, and never those of another plan."""

    def __post_init__(self) -> None:
        for name in ("episodes", "tuning_episodes", "candidates", "window", "most_steps"):
            _at_least(f"rollouts.{name}", getattr(self, name), 1)
        for name in ("seed", "tuning_seed"):
            _at_least(f"rollouts.{name}", getattr(self, name), 0)
        _different("rollouts.tasks", self.tasks)


@dataclass(frozen=True, slots=True)
class Column:
    """One way of acting."""

    name: str
    title: str = ""
    """In tables; the name where empty."""
    method: Method = "none"
    pick: Pick = "best"
    data: Data = "all"
    rewards: Rewards = "segments"
    tau_scale: float = 1.0
    """Of the calibrated tau (supplement G.5)."""
    seeds: tuple[int, ...] = (0,)
    """Of the base policy's training, one policy each."""
    paper: str = ""
    """Row of `jiti.runtime.benchmark.paper.FIGURES` that is shown beside it."""

    def __post_init__(self) -> None:
        for name, kind in (("method", Method), ("pick", Pick), ("data", Data), ("rewards", Rewards)):
            _one_of(f"column.{name}", getattr(self, name), get_args(kind))
        if not self.name or not self.name.replace("-", "").replace("_", "").isalnum():
            raise UsageError(f"column.name is {self.name!r}; it must be of letters, digits, - and _")
        if not self.tau_scale > 0:
            raise UsageError(f"column.tau_scale is {self.tau_scale}; it must be above 0")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise UsageError(f"column.seeds is {list(self.seeds)}; name different seeds of 0 or more")
        if self.paper:
            from jiti.runtime.benchmark.paper import FIGURES

            _one_of("column.paper", self.paper, tuple(FIGURES))

    @property
    def shown(self) -> str:
        return self.title or self.name


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two columns on the same initial states."""

    first: str
    second: str
    outcome: Literal["elegant", "success"] = "elegant"

    def __post_init__(self) -> None:
        _one_of("compare.outcome", self.outcome, ("elegant", "success"))


@dataclass(frozen=True, slots=True)
class BenchmarkPlan:
    """All of it; a TOML file's sections."""

    name: str
    title: str
    data: DataPlan
    columns: tuple[Column, ...]
    curate: CuratePlan = field(default_factory=CuratePlan)
    policy: PolicyPlan = field(default_factory=PolicyPlan)
    critic: CriticPlan = field(default_factory=CriticPlan)
    tau: TauPlan = field(default_factory=TauPlan)
    rollouts: RolloutsPlan = field(default_factory=RolloutsPlan)
    comparisons: tuple[Comparison, ...] = ()
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Tasks that are averaged apart as well, by name: seen, unseen."""
    note: str = ""
    """What a reader of the tables should know."""
    quick: bool = False
    """Made small: proves nothing but that it runs."""
    tuning: bool = False
    """Played from the tuning seeds."""

    def __post_init__(self) -> None:
        names = [column.name for column in self.columns]
        if not names:
            raise UsageError("there is no [[column]]; name at least one")
        if twice := [name for name in names if names.count(name) > 1]:
            raise UsageError(f"two columns are called {twice[0]}")
        for comparison in self.comparisons:
            for side in ("first", "second"):
                _one_of(f"compare.{side}", getattr(comparison, side), tuple(names))
        for where, tasks in (("critic.tasks", self.critic.tasks), ("rollouts.tasks", self.rollouts.tasks)):
            for task in tasks:
                _one_of(where, task, self.data.tasks)
        for group, tasks in self.groups.items():
            _different(f"groups.{group}", tasks)
            for task in tasks:
                _one_of(f"groups.{group}", task, self.tasks)
        self._check_seeds()

    @property
    def tasks(self) -> tuple[str, ...]:
        """That are played."""
        return self.rollouts.tasks or self.data.tasks

    @property
    def critic_tasks(self) -> tuple[str, ...]:
        return self.critic.tasks or self.data.tasks

    @property
    def seed(self) -> int:
        """Of the first episode that is played."""
        return self.rollouts.tuning_seed if self.tuning else self.rollouts.seed

    @property
    def episodes(self) -> int:
        """Of a cell."""
        return self.rollouts.tuning_episodes if self.tuning else self.rollouts.episodes

    def column(self, name: str) -> Column:
        """Raises UsageError that names the nearest."""
        _one_of("--columns", name, tuple(column.name for column in self.columns))
        return next(column for column in self.columns if column.name == name)

    def _check_seeds(self) -> None:
        """Nothing that was learned from, tuned on or calibrated on is evaluated."""
        spans = {
            "data.seed": range(self.data.seed, self.data.seed + self.data.episodes),
            "tau.seed": range(self.tau.seed, self.tau.seed + self.tau.episodes),
            "rollouts.seed": range(self.rollouts.seed, self.rollouts.seed + self.rollouts.episodes),
            "rollouts.tuning_seed": range(
                self.rollouts.tuning_seed, self.rollouts.tuning_seed + self.rollouts.tuning_episodes
            ),
        }
        names = list(spans)
        for place, name in enumerate(names):
            for other in names[:place]:
                a, b = spans[name], spans[other]
                if max(a.start, b.start) < min(a.stop, b.stop):
                    raise UsageError(
                        f"{name} gives the seeds {a.start} to {a.stop - 1}, and {other} {b.start} to {b.stop - 1}: "
                        "what was learned from, calibrated or tuned on must not be evaluated. Choose other seeds"
                    )


def smaller(plan: BenchmarkPlan, task: str | None = None) -> BenchmarkPlan:
    """A plan of the same columns that ends in minutes and proves nothing but that it runs: one task, by default the
    first, one training seed, a few steps."""
    task = task or plan.tasks[0]
    taught = task if task in plan.critic_tasks else plan.critic_tasks[0]
    tasks = tuple(dict.fromkeys((task, taught)))
    return replace(
        plan,
        quick=True,
        data=replace(plan.data, tasks=tasks, episodes=8),
        policy=replace(plan.policy, steps=20),
        critic=replace(plan.critic, steps=20, tasks=(taught,)),
        tau=replace(plan.tau, episodes=1),
        rollouts=replace(plan.rollouts, tasks=(task,), episodes=2, tuning_episodes=1, most_steps=60),
        columns=tuple(replace(column, seeds=column.seeds[:1]) for column in plan.columns),
        groups={name: (task,) for name, tasks in plan.groups.items() if task in tasks},
    )


def _at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise UsageError(f"{name} is {value}; it must be at least {least}")


def _different(name: str, values: Sequence[str]) -> None:
    if twice := [value for value in values if values.count(value) > 1]:
        raise UsageError(f"{name} names {twice[0]} twice; once is enough")


def _one_of(name: str, value: Any, known: Sequence[str]) -> None:
    from jiti.nearest import nearest

    if value not in known:
        raise UsageError(f"{name} is {value!r}; {nearest(value, known)}")
