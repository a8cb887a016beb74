"""What rollouts say: rates with their intervals, interventions, times, and pairs of guidances on the same states."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.rollout.result import Rollout

Z_95 = 1.959963984540054
"""Of the standard normal distribution at 97.5%."""
DRAWS = 10_000
"""Of the bootstrap. Our choice: its own error is then a fiftieth of the interval."""


@dataclass(frozen=True, slots=True)
class Rate:
    """A share with its 95% interval by Wilson's score."""

    count: int
    of: int

    @property
    def value(self) -> float:
        return self.count / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        return wilson(self.count, self.of)


def wilson(count: int, of: int, z: float = Z_95) -> tuple[float, float]:
    """Lowest and highest rate that `count` of `of` is no surprise to (Wilson 1927); 0 to 1 where there are none."""
    if not of:
        return 0.0, 1.0
    rate, share = count / of, z * z / of
    middle = (rate + share / 2) / (1 + share)
    half = z / (1 + share) * math.sqrt(rate * (1 - rate) / of + share / of / 4)
    # Exactly 0 and 1 at the ends, where rounding would leave 1e-17.
    return (0.0 if count == 0 else middle - half), (1.0 if count == of else middle + half)


class Outcome(Protocol):
    """What two guidances are compared by: a rollout of simulation, or an episode that a person judged."""

    @property
    def label(self) -> str: ...

    @property
    def task(self) -> str: ...

    @property
    def seed(self) -> int: ...

    @property
    def success(self) -> bool | None: ...

    @property
    def elegant(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class MethodSummary:
    """All rollouts of one guidance."""

    label: str
    success: Rate
    elegant: Rate
    """The ESR."""
    interventions: float
    """An episode."""
    triggered: Rate
    """Of decisions."""
    changed: Rate
    """Of decisions: where another chunk than the default was executed."""
    problems: int
    """Decisions at which the critic gave no number."""
    decision_ms: float
    """Mean time that policy and critic took for a decision, without the simulator."""
    step_ms: float
    """The same for a step: a decision is for a whole chunk."""
    sim_ms: float
    """Mean time of the simulator for a step."""
    cut_off: int
    """Episodes that ran out of steps."""


def summarize(rollouts: Sequence[Rollout]) -> list[MethodSummary]:
    """One summary a guidance, in the order in which they come."""
    return [_summary(label, own) for label, own in _by_label(rollouts).items()]


@dataclass(frozen=True, slots=True)
class Pairing:
    """Two guidances on the same initial states."""

    first: str
    second: str
    pairs: int
    both: int
    only_first: int
    only_second: int
    neither: int
    p: float
    """Of an exact McNemar test, two-sided: how often coins would split the pairs that differ at least so unevenly."""
    difference: float
    """Rate of the second less that of the first."""
    interval: tuple[float, float]
    """95% of the difference, by a bootstrap over pairs."""


def compare(
    first: Sequence[Outcome], second: Sequence[Outcome], *, outcome: str = "elegant", draws: int = DRAWS, seed: int = 0
) -> Pairing:
    """Compare two guidances by `elegant` or `success`, on the states (task and seed) that both have played.

    Draws of the bootstrap are within each task, so that each keeps its weight; they follow from the seed. Raises
    UsageError where there is no such state, or one was played twice.
    """
    a, b = _outcomes(first, outcome), _outcomes(second, outcome)
    shared = sorted(a.keys() & b.keys())
    if not shared:
        raise UsageError("the guidances have no initial state in common; play them with the same --seed.")
    table = np.array([(a[key], b[key]) for key in shared], int)
    only_a, only_b = int(((table[:, 0] == 1) & (table[:, 1] == 0)).sum()), int((table[:, 1] > table[:, 0]).sum())
    both = int(table.all(1).sum())
    differences = (table[:, 1] - table[:, 0]).astype(float)
    return Pairing(
        first[0].label,
        second[0].label,
        len(shared),
        both,
        only_a,
        only_b,
        len(shared) - both - only_a - only_b,
        mcnemar(only_a, only_b),
        float(differences.mean()),
        bootstrap_interval(differences, [task for task, _ in shared], draws=draws, seed=seed),
    )


def mcnemar(only_first: int, only_second: int) -> float:
    """How often fair coins split the pairs that differ at least so unevenly, exactly; 1 where none differ."""
    from scipy.stats import binomtest

    differ = only_first + only_second
    return float(binomtest(only_second, differ).pvalue) if differ else 1.0


def compare_all(rollouts: Sequence[Outcome], outcome: str = "elegant") -> list[Pairing]:
    """Every pair of guidances, in the order in which they come."""
    return [compare(a, b, outcome=outcome) for a, b in combinations(_by_label(rollouts).values(), 2)]


def bootstrap_interval(
    values: np.ndarray, groups: Sequence[str], *, draws: int = DRAWS, seed: int = 0
) -> tuple[float, float]:
    """95% percentile interval of the mean of values (n,), drawn with replacement within each group."""
    random = np.random.default_rng(seed)
    names = np.array(groups)
    sums = np.zeros(draws)
    for name in sorted(set(groups)):
        own = values[names == name]
        sums += own[random.integers(len(own), size=(draws, len(own)))].sum(1)
    low, high = np.quantile(sums / len(values), [0.025, 0.975])
    return float(low), float(high)


def _summary(label: str, rollouts: Sequence[Rollout]) -> MethodSummary:
    count = len(rollouts)
    choices = [choice for rollout in rollouts for choice in rollout.choices]
    actions = max(1, sum(rollout.steps - 1 for rollout in rollouts))
    triggered = sum(choice.triggered for choice in choices)
    decided_s = sum(choice.step_s for choice in choices)
    return MethodSummary(
        label,
        Rate(sum(r.success for r in rollouts), count),
        Rate(sum(r.elegant for r in rollouts), count),
        triggered / count,
        Rate(triggered, len(choices)),
        Rate(sum(choice.chosen != 0 for choice in choices), len(choices)),
        sum(r.problems for r in rollouts),
        1e3 * decided_s / max(1, len(choices)),
        1e3 * decided_s / actions,
        1e3 * sum(r.sim_s for r in rollouts) / actions,
        sum(r.cut_off for r in rollouts),
    )


def _by_label[T: Outcome](rollouts: Sequence[T]) -> dict[str, list[T]]:
    found: dict[str, list[T]] = {}
    for rollout in rollouts:
        found.setdefault(rollout.label, []).append(rollout)
    return found


def _outcomes(rollouts: Sequence[Outcome], outcome: str) -> dict[tuple[str, int], bool]:
    found: dict[tuple[str, int], bool] = {}
    for rollout in rollouts:
        key = (rollout.task, rollout.seed)
        if key in found:
            raise UsageError(f"{rollout.label} was played twice from the seed {rollout.seed} of {rollout.task}")
        found[key] = bool(getattr(rollout, outcome))
    return found
