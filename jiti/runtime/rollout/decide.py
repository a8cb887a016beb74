"""One decision of an agent, whatever executes it: in simulation, or on an arm."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.candidates.observation import Observation
from jiti.runtime.guidance import Decision, Guidance, Guide, Score
from jiti.runtime.rollout.agent import Agent


@dataclass(frozen=True, slots=True)
class Decided:
    """A decision, and where and on what it was made."""

    decision: Decision
    frame: int
    """Step of the episode, from 0, whose state was observed."""
    chunks: np.ndarray
    """Candidates (n, K, A) that were drawn, the default first."""
    observe_s: float
    """Seconds that it took to prepare the observation."""


def agent_for(guidance: Guidance, agent: Agent) -> Agent:
    """Without a critic for `none`, which asks none. Raises UsageError when a critic is needed and there is none."""
    if guidance.method == "none":
        return Agent(agent.sampler)
    if agent.scorer is None:
        raise UsageError(f"--guidance {guidance.method} needs a critic: pass --critic RUN")
    return agent


def decide(
    agent: Agent, guide: Guide, observations: Sequence[Observation], instruction: str, frame: int
) -> tuple[np.ndarray, Decided]:
    """The chunk (K, A) to execute, on the newest of the observations; those before it come first."""
    *before, newest = observations
    began = perf_counter()
    ready = agent.sampler.observe(newest, instruction, before)
    score: Score = _no_critic if agent.scorer is None else agent.scorer.at(newest, instruction, ready)
    observe_s = perf_counter() - began
    drawn: list[np.ndarray] = []

    def sample(noise: np.ndarray) -> np.ndarray:
        drawn.append(ready.sample(noise))
        return drawn[-1]

    chunk, decision = guide.decide(sample, score)
    return chunk, Decided(decision, frame, np.concatenate(drawn), observe_s)


def _no_critic(chunks: np.ndarray) -> np.ndarray:
    """Is not called: `none` asks no critic."""
    return np.full(len(chunks), np.nan)
