"""Who acts in a rollout: a sampler of a frozen policy, and a critic where one is asked."""

from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from jiti.runtime.candidates.observation import Observation
from jiti.runtime.guidance import Score
from jiti.runtime.rollout.plan import RolloutPlan

if TYPE_CHECKING:
    from jiti.runtime import candidates


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
    def chunk(self) -> int:
        """K, actions of a chunk."""
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

    torch.set_num_threads(1)
    sampler, scorer = open_pair(plan.policy, plan.critic, plan.device, observation)
    # No more of a chunk than is executed or valued: SmolVLA makes 50 actions otherwise. As many for `none`, so that it
    # is an exact pair of the others.
    return Agent(sampler.only(max(sampler.executed, scorer.chunk if scorer else 0)), scorer)


def open_pair(
    policy: str, critic: str | None, device: str, observation: Observation
) -> "tuple[candidates.Sampler, candidates.Scorer | None]":
    """A policy, whose chunks are whole, and a critic. Raises what `open_agent` does."""
    from jiti.runtime.candidates import check_pair, open_sampler, open_scorer

    with redirect_stdout(StringIO()):  # where lerobot says that it loads weights, and `--json` is printed
        sampler = open_sampler(policy, device)
        if critic is None:
            return sampler, None
        scorer = open_scorer(critic, device)
    check_pair(sampler, scorer, observation)
    return sampler, scorer
