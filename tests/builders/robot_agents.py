"""Policies and critics for an arm that take as long as real ones, and those that fail; a process of inference imports
them by name.

What SmolVLA takes: 112 ms for a chunk and 449 ms for eight (supplement G.6), of which what it makes of the observation
is shared.
"""

import os
from collections.abc import Sequence
from time import sleep

import numpy as np

from jiti.runtime.candidates.observation import Observation
from jiti.runtime.robot.inference import Brain
from jiti.runtime.rollout.agent import Agent

CHUNK, JOINTS = 50, 6
ONE_S, EIGHT_S = 0.112, 0.449
EACH_S = (EIGHT_S - ONE_S) / 7
STEP = 1.0
"""Degrees: 30 a second."""
ENDS = -30.0, 30.0


class Sweeping:
    """Turns the first joint to and fro, and leaves the others where they are."""

    noise_shape = (CHUNK, JOINTS)
    history = 1

    def __init__(self, *, slow: float = 1.0, chunk: int = CHUNK) -> None:
        """`slow`: multiple of what SmolVLA takes."""
        self.chunk = self.executed = chunk
        self.slow, self._way = slow, 1.0

    def observe(self, observation: Observation, instruction: str, before: Sequence[Observation] = ()) -> "SeenSweep":
        state = observation["observation.state"]
        if not ENDS[0] < state[0] < ENDS[1]:
            self._way = -float(np.sign(state[0]))
        return SeenSweep(state, self._way, self.slow, self.chunk)


class SeenSweep:
    def __init__(self, state: np.ndarray, way: float, slow: float, chunk: int = CHUNK) -> None:
        self._state, self._way, self._slow, self._chunk, self._looked = state, way, slow, chunk, False

    def sample(self, noise: np.ndarray) -> np.ndarray:
        sleep(self._slow * (len(noise) * EACH_S + (0.0 if self._looked else ONE_S - EACH_S)))
        self._looked = True
        chunks = np.tile(self._state, (len(noise), self._chunk, 1))
        chunks[:, :, 0] += self._way * STEP * np.arange(1, self._chunk + 1)
        return chunks


class EveryThird:
    """Its values jump at every third decision, so that a tau of 0.5 triggers there."""

    def __init__(self) -> None:
        self._asked = 0

    def at(self, observation: Observation, instruction: str, seen: object):
        self._asked += 1
        value = float(self._asked % 3 == 0)
        return lambda chunks: value + 1e-3 * np.arange(len(chunks))


class Spoilt(Sweeping):
    """Like the other, and gives something else from the second decision of an episode on."""

    def __init__(self, what: str) -> None:
        super().__init__(slow=0.1)
        self._what, self._asked = what, 0

    def observe(self, observation: Observation, instruction: str, before: Sequence[Observation] = ()) -> "SeenSweep":
        seen = super().observe(observation, instruction, before)
        self._asked += 1
        if self._asked <= 2:  # one is to warm up
            return seen
        if self._what == "stall":
            sleep(3600)
        if self._what == "crash":
            os._exit(9)
        return SeenSpoilt(seen, self._what)


class SeenSpoilt(SeenSweep):
    def __init__(self, seen: SeenSweep, what: str) -> None:
        super().__init__(seen._state, seen._way, 0.1)
        self._what = what

    def sample(self, noise: np.ndarray) -> np.ndarray:
        chunks = super().sample(noise)
        chunks[:, :, 2] = {"nan": np.nan, "far": 1000.0}[self._what]
        return chunks


def smolvla(brain: Brain, observation: Observation) -> Agent:
    return Agent(Sweeping(), EveryThird())


def quick(brain: Brain, observation: Observation) -> Agent:
    return Agent(Sweeping(slow=0.1), EveryThird())


def ten_actions(brain: Brain, observation: Observation) -> Agent:
    return Agent(Sweeping(chunk=10), EveryThird())


def short_chunks(brain: Brain, observation: Observation) -> Agent:
    """Of four actions, an eighth of a second, for which full guidance takes nearly half a second."""
    return Agent(Sweeping(chunk=4), EveryThird())


def without_critic(brain: Brain, observation: Observation) -> Agent:
    return Agent(Sweeping(slow=0.1))


def nan(brain: Brain, observation: Observation) -> Agent:
    return Agent(Spoilt("nan"), EveryThird())


def far(brain: Brain, observation: Observation) -> Agent:
    return Agent(Spoilt("far"), EveryThird())


def stall(brain: Brain, observation: Observation) -> Agent:
    return Agent(Spoilt("stall"), EveryThird())


def crash(brain: Brain, observation: Observation) -> Agent:
    return Agent(Spoilt("crash"), EveryThird())
