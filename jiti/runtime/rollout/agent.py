"""Who acts in a rollout: a sampler of a frozen policy, and a critic where one is asked."""

from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Any, Protocol

import numpy as np

from jiti.runtime.candidates.observation import Observation
from jiti.runtime.guidance import Score
from jiti.runtime.rollout.plan import RolloutPlan


class Seen(Protocol):
    """One observation, ready for any number of chunks."""

    def sample(self, noise: np.ndarray) -> np.ndarray:
        """Chunks (n, K, A) in the robot's units from noise (n, K', A')."""
        ...


class Sampler(Protocol):
    """What `jiti.runtime.candidates.open_sampler` gives."""

    @property
    def noise_shape(self) -> tuple[int, int]:
        """(K', A')"""
        ...

    @property
    def executed(self) -> int:
        """Actions of a chunk that are executed before the next decision."""
        ...

    @property
    def history(self) -> int:
        """Observations that a decision looks at, the newest included."""
        ...

    def observe(self, observation: Observation, instruction: str, before: Sequence[Observation] = ()) -> Any:
        """A `Seen`."""
        ...


class Scorer(Protocol):
    """What `jiti.runtime.candidates.open_scorer` gives."""

    def at(self, observation: Observation, instruction: str, seen: Any) -> Score:
        """What values chunks (n, K, A) as (n,)."""
        ...


@dataclass(frozen=True)
class Agent:
    """Serves any number of episodes, of any guidance."""

    sampler: Sampler
    scorer: Scorer | None = None


OpenAgent = Callable[[RolloutPlan, Observation], Agent]
"""Makes the agent of a plan that fits an observation; importable, because workers call it."""


def open_agent(plan: RolloutPlan, observation: Observation) -> Agent:
    """The plan's policy and critic, on one thread of torch, because each core plays an episode of its own.

    Raises UsageError or SourceError for what cannot be opened, does not fit together, or does not fit an observation.
    """
    import torch

    from jiti.runtime.candidates import check_pair, open_sampler, open_scorer

    torch.set_num_threads(1)
    with redirect_stdout(StringIO()):  # where lerobot says that it loads weights, and `--json` is printed
        sampler = open_sampler(plan.policy, plan.device)
        if plan.critic is None:
            return Agent(sampler.only(sampler.executed))
        scorer = open_scorer(plan.critic, plan.device)
    check_pair(sampler, scorer, observation)
    # No more of a chunk than is executed or valued: SmolVLA makes 50 actions otherwise. As many for `none`, so that it
    # is an exact pair of the others.
    return Agent(sampler.only(max(sampler.executed, scorer.chunk)), scorer)
