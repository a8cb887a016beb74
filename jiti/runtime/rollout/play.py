"""One episode: observe, decide, execute the chunk, until the environment ends it."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.candidates.observation import Observation
from jiti.runtime.guidance import Decision, Guidance, Guide, Score
from jiti.runtime.rollout.agent import Agent
from jiti.runtime.sim.env import ElegantEnv
from jiti.runtime.sim.monitor import Outcome


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


@dataclass(frozen=True, slots=True)
class Played:
    """How an episode went."""

    outcome: Outcome
    decided: tuple[Decided, ...]
    cut_off: bool
    """Whether it ran out of steps."""
    sim_s: float
    """Seconds in the simulator, pictures included."""

    @property
    def interventions(self) -> int:
        """Decisions at which candidates were looked at, whichever was then taken."""
        return sum(d.decision.triggered for d in self.decided)


class Watcher:
    """Is told of an episode while it is played; does nothing by itself."""

    def decided(self, env: ElegantEnv, decided: Decided) -> None:
        """Before the chosen chunk is executed."""

    def stepped(self, env: ElegantEnv, step: int, seen: dict[str, Any], action: np.ndarray | None) -> None:
        """At each state, with the environment's observation and the action (7,) that follows; None after the last."""


def lerobot_keys(seen: dict[str, Any]) -> Observation:
    """An observation of the environment under the names that datasets of `jiti curate` have."""
    pictures = {f"observation.images.{name}": picture for name, picture in seen.get("pixels", {}).items()}
    return {
        "observation.state": seen["agent_pos"],
        "observation.environment_state": seen["environment_state"],
        **pictures,
    }


def play(env: ElegantEnv, agent: Agent, guidance: Guidance, seed: int, watchers: Sequence[Watcher] = ()) -> Played:
    """Play one episode, whose initial state and noise follow from the seed, whatever the guidance.

    Raises UsageError when the guidance needs a critic and there is none, or an action is no number.
    """
    sampler = agent.sampler
    if guidance.method == "none":
        agent = Agent(sampler)  # none asks no critic
    elif agent.scorer is None:
        raise UsageError(f"--guidance {guidance.method} needs a critic: pass --critic RUN")
    guide = Guide(guidance, seed, sampler.noise_shape)
    began = perf_counter()
    seen, _ = env.reset(seed=seed)
    sim_s = perf_counter() - began
    before: deque[Observation] = deque(maxlen=max(1, sampler.history))
    before.append(lerobot_keys(seen))
    decided: list[Decided] = []
    step, ended, cut_off = 0, False, False
    while not ended:
        chunk = _decide(env, agent, guide, tuple(before), step, decided)
        for watcher in watchers:
            watcher.decided(env, decided[-1])
        for action in chunk[: sampler.executed]:
            if not np.isfinite(action).all():
                raise UsageError(
                    f"the policy gave an action that is no number at step {step} of the episode with seed {seed}. "
                    "Train it again, or pass another --policy."
                )
            action = np.clip(action, -1, 1)  # as the environment does, so that recordings say what was done
            for watcher in watchers:
                watcher.stepped(env, step, seen, action)
            began = perf_counter()
            seen, _, terminated, cut_off, _ = env.step(action)
            sim_s += perf_counter() - began
            before.append(lerobot_keys(seen))
            step += 1
            if ended := terminated or cut_off:
                break
    for watcher in watchers:
        watcher.stepped(env, step, seen, None)
    return Played(env.monitor.outcome(), tuple(decided), cut_off, sim_s)


def _decide(
    env: ElegantEnv,
    agent: Agent,
    guide: Guide,
    observations: tuple[Observation, ...],
    step: int,
    decided: list[Decided],
) -> np.ndarray:
    """The chunk (K, A) to execute; the decision is added to those of the episode."""
    *before, newest = observations
    instruction = env.task_description
    began = perf_counter()
    ready = agent.sampler.observe(newest, instruction, before)
    score: Score = _no_critic if agent.scorer is None else agent.scorer.at(newest, instruction, ready)
    observe_s = perf_counter() - began
    drawn: list[np.ndarray] = []

    def sample(noise: np.ndarray) -> np.ndarray:
        drawn.append(ready.sample(noise))
        return drawn[-1]

    chunk, decision = guide.decide(sample, score)
    decided.append(Decided(decision, step, np.concatenate(drawn), observe_s))
    return chunk


def _no_critic(chunks: np.ndarray) -> np.ndarray:
    """Is not called: `none` asks no critic."""
    return np.full(len(chunks), np.nan)
