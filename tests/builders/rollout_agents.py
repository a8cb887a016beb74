"""Policies and critics that are arithmetic, for rollouts that take no learning; workers import them by name."""

import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jiti.runtime.candidates.observation import Observation
from jiti.runtime.rollout.agent import Agent
from jiti.runtime.rollout.plan import RolloutPlan

CHUNK, ACTION = 10, 7


class Wandering:
    """Chunks are their noise, small; the observation counts as well, so that what was seen matters."""

    noise_shape = (CHUNK, ACTION)
    chunk = CHUNK
    history = 1

    def __init__(self, executed: int = CHUNK) -> None:
        self.executed = executed

    def observe(self, observation: Observation, instruction: str, before: Sequence[Observation] = ()) -> "SeenState":
        return SeenState(observation["observation.state"])


@dataclass
class SeenState:
    state: np.ndarray

    def sample(self, noise: np.ndarray) -> np.ndarray:
        return 0.3 * noise + 0.1 * self.state[:ACTION] - 0.2


class Summing:
    """Values a chunk by the sum of its actions, and the place."""

    def at(self, observation: Observation, instruction: str, seen: object):
        def score(chunks: np.ndarray) -> np.ndarray:
            return chunks.sum((1, 2)) + 10 * float(observation["observation.state"][0])

        return score


class Silent:
    """Has no number for anything at the third decision and after."""

    def at(self, observation: Observation, instruction: str, seen: object):
        self.asked = getattr(self, "asked", 0) + 1
        value = 1.0 if self.asked < 3 else float("nan")
        return lambda chunks: np.full(len(chunks), value)


class LateSumming(Summing):
    """Has no number for anything until the hand has moved."""

    start: np.ndarray | None = None

    def at(self, observation: Observation, instruction: str, seen: object):
        state = observation["observation.state"]
        if self.start is None or np.array_equal(state, self.start):
            self.start = state.copy()
            return lambda chunks: np.full(len(chunks), np.nan)
        return super().at(observation, instruction, seen)


def wandering(plan: RolloutPlan, observation: Observation) -> Agent:
    return Agent(Wandering(), Summing())


def without_numbers(plan: RolloutPlan, observation: Observation) -> Agent:
    return Agent(Wandering(), Silent())


def first_without_number(plan: RolloutPlan, observation: Observation) -> Agent:
    return Agent(Wandering(), LateSumming())


def broken(plan: RolloutPlan, observation: Observation) -> Agent:
    class Broken(Wandering):
        def observe(self, observation: Observation, instruction: str, before: Sequence[Observation] = ()) -> SeenState:
            return SeenState(np.full(8, np.nan))

    return Agent(Broken(), Summing())


def killed(plan: RolloutPlan, observation: Observation) -> Agent:
    """Ends its own process, as the system does when memory runs out, in the third decision of one episode that is
    guided; once, if the file `armed` is in the critic's folder."""

    class Deadly(Summing):
        asked = 0

        def at(self, observation: Observation, instruction: str, seen: object):
            self.asked += 1
            marker = Path(str(plan.critic)) / "armed"
            if self.asked == 3 and marker.exists():
                marker.unlink()
                os.kill(os.getpid(), signal.SIGKILL)
            return super().at(observation, instruction, seen)

    return Agent(Wandering(), Deadly())
