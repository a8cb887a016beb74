"""Policy and critic in a process of their own, so that the arm's loop waits neither for them nor for their interpreter.

In one process, torch's Python between its kernels kept the loop from its next step; and what crashes or hangs there now
leaves a loop that holds the arm and says so.
"""

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from time import perf_counter
from typing import Any, Self

import numpy as np

from jiti.errors import JitiError, RobotError, UsageError
from jiti.runtime.candidates.observation import Observation
from jiti.runtime.guidance import Guidance, Guide
from jiti.runtime.rollout.agent import Agent, open_pair
from jiti.runtime.rollout.decide import Decided, agent_for, decide

END_S = 5.0
"""How long it may take to end by itself. Our choice."""
LOOK_S = 0.05
"""Between two looks at a policy that is being opened. Our choice."""
GONE_S = 0.1
"""How long an arm's loop waits to tell what a process ended with. Our choice: less than its watchdog does."""


@dataclass(frozen=True, slots=True)
class Brain:
    """Who decides, and how."""

    policy: str
    critic: str | None
    guidances: tuple[Guidance, ...]
    instruction: str
    device: str = "cpu"
    execute: int = 0
    """Actions from one decision to the next; 0: as many as the policy means to, at most half a chunk."""


@dataclass(frozen=True, slots=True)
class Facts:
    """What the loop must know of an agent."""

    execute: int
    """Actions from one decision to the next."""
    history: int
    """Observations that a decision looks at, one a step, the newest included."""


OpenAgent = Callable[[Brain, Observation], Agent]
"""Makes the agent that fits an observation; importable, because the process calls it."""


def open_agent(brain: Brain, observation: Observation) -> Agent:
    """Raises UsageError or SourceError for what cannot be opened, does not fit together, or does not fit the arm."""
    sampler, scorer = open_pair(brain.policy, brain.critic, brain.device, observation)
    execute = brain.execute or _half(sampler)
    return Agent(sampler.only(max(2 * execute, scorer.chunk if scorer else 0)), scorer)


def _half(sampler: Any) -> int:
    return max(1, min(sampler.executed, sampler.chunk // 2))


@dataclass(frozen=True, slots=True)
class Answer:
    """A decision that has arrived."""

    chunk: np.ndarray
    """(H, A)"""
    decided: Decided
    round_trip_s: float
    """From the question on, pictures sent and chunks received included."""


class Inference:
    """The side of the loop. One question at a time."""

    def __init__(self, brain: Brain, make_agent: OpenAgent = open_agent) -> None:
        """Imports begin at once; nothing is waited for."""
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, brain, make_agent), daemon=True)
        self._process.start()
        theirs.close()
        self.asked_s: float | None = None
        """When the question was put that has no answer yet, in seconds of `perf_counter`."""

    def open(self, observation: Observation, meanwhile: Callable[[], object] = lambda: None) -> Facts:
        """Wait until policy and critic are there for such observations; `meanwhile` is called again and again, and what
        it raises ends the wait. Raises what `make_agent` does."""
        self._send("open", observation)
        while not self._pipe.poll(LOOK_S):
            meanwhile()
        return self._receive()

    def begin(self, seed: int, guidance: Guidance) -> None:
        """A new episode with one of the guidances. An answer to a question of the one before is waited for, and
        forgotten."""
        if self.asked_s is not None:
            self._receive()
            self.asked_s = None
        self._send("begin", seed, guidance)
        self._receive()

    def ask(self, observations: Sequence[Observation], frame: int) -> None:
        """Begin a decision on the last of these observations, which is that of a frame."""
        self.asked_s = perf_counter()
        self._send("decide", tuple(observations), frame)

    def answer(self) -> Answer | None:
        """What was decided; None while it is being done. Raises what the policy or the critic does."""
        if self.asked_s is None or not self._pipe.poll():
            return None
        chunk, decided = self._receive()
        took_s, self.asked_s = perf_counter() - self.asked_s, None
        return Answer(chunk, decided, took_s)

    def close(self) -> None:
        self._pipe.close()
        if self.asked_s is not None:
            self._process.kill()  # nobody waits for what it does
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, *message: Any) -> None:
        with suppress(ConnectionError):  # told by what is received
            self._pipe.send(message)

    def _receive(self) -> Any:
        try:
            answer, error = self._pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join(GONE_S)
            raise RobotError(
                f"the process of policy and critic has ended with {self._process.exitcode}: the machine may be out of "
                "memory. Pass a smaller --policy, or another --device."
            ) from None
        if error is not None:
            raise error
        return answer


def _serve(pipe: Connection, brain: Brain, make_agent: OpenAgent) -> None:
    """The side of policy and critic; ends with the other one."""
    # Whoever ends a program may send it to every process of it; this one ends with the loop.
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    desk = _Desk(brain, make_agent)
    with suppress(EOFError, OSError):
        while True:
            name, *arguments = pipe.recv()
            try:
                pipe.send((getattr(desk, name)(*arguments), None))
            except JitiError as error:
                pipe.send((None, error))
            except Exception as error:
                pipe.send((None, RobotError(f"policy or critic failed: {type(error).__name__}: {error}")))


class _Desk:
    def __init__(self, brain: Brain, make_agent: OpenAgent) -> None:
        self._brain, self._make_agent = brain, make_agent

    def open(self, observation: Observation) -> Facts:
        self._opened = self._make_agent(self._brain, observation)
        sampler = self._opened.sampler
        facts = Facts(self._brain.execute or _half(sampler), max(1, sampler.history))
        if self._brain.execute > sampler.chunk:
            raise UsageError(
                f"the policy's chunks have {sampler.chunk} actions: pass --execute {sampler.chunk} or less."
            )
        # The first decision compiles and allocates: not while an arm waits for it.
        for guidance in self._brain.guidances:
            self.begin(0, guidance)
            self.decide((observation,) * facts.history, 0)
        return facts

    def begin(self, seed: int, guidance: Guidance) -> None:
        self._agent = agent_for(guidance, self._opened)
        self._guide = Guide(guidance, seed, self._opened.sampler.noise_shape)

    def decide(self, observations: tuple[Observation, ...], frame: int) -> tuple[np.ndarray, Decided]:
        return decide(self._agent, self._guide, observations, self._brain.instruction, frame)
