"""One episode: observe, decide, execute the chunk, until the environment ends it."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.candidates.observation import Observation
from jiti.runtime.guidance import Guidance, Guide
from jiti.runtime.rollout.agent import Agent
from jiti.runtime.rollout.decide import Decided, agent_for, decide
from jiti.runtime.sim.env import ElegantEnv
from jiti.runtime.sim.monitor import Outcome


@dataclass(frozen=True, slots=True)
class Played:
    """How an episode went."""

    outcome: Outcome
    decided: tuple[Decided, ...]
    cut_off: bool
    """Whether it ran out of steps."""
    sim_s: float
    """Seconds in the simulator, pictures included."""


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
    agent, sampler = agent_for(guidance, agent), agent.sampler
    guide = Guide(guidance, seed, sampler.noise_shape)
    began = perf_counter()
    seen, _ = env.reset(seed=seed)
    sim_s = perf_counter() - began
    before: deque[Observation] = deque(maxlen=max(1, sampler.history))
    before.append(lerobot_keys(seen))
    decided: list[Decided] = []
    step, ended, cut_off = 0, False, False
    while not ended:
        chunk, made = decide(agent, guide, tuple(before), env.task_description, step)
        decided.append(made)
        for watcher in watchers:
            watcher.decided(env, made)
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
