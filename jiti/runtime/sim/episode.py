"""One episode from a reset to its outcome, whoever acts."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from jiti.runtime.sim.monitor import Monitor, Outcome

MOST_STEPS = 700
"""After which a demonstration counts as stuck. Our choice: the longest, with the stove, takes about 400."""


class Actor(Protocol):
    """Gives one action (7,) a step for the scene as it is then; None when it is done."""

    def act(self) -> np.ndarray | None: ...


def run_episode(
    monitor: Monitor,
    actor: Actor,
    step: Callable[[np.ndarray], None],
    watch: Callable[[int, np.ndarray | None], None] | None = None,
) -> Outcome:
    """Let an actor act in a scene that was reset until it is done, and judge what it did.

    `step` applies an action; `watch` is called at each state with its number and the action that follows it, None after
    the last, before that is applied.
    """
    monitor.begin()
    count = 0
    while True:
        action = actor.act() if count < MOST_STEPS else None
        if watch is not None:
            watch(count, action)
        if action is None:
            return monitor.outcome()
        step(action)
        monitor.look()
        count += 1
