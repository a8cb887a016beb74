"""Which action is due while the next chunk is still being computed.

Let the arm have executed p actions when it was observed, and action i of the chunk that is decided on that observation
is the one for p + i. When the chunk arrives, actions that were executed meanwhile are over, and it goes on behind
them. Where the arm had nothing left to execute it was held, and time stood still for it: nothing is over then, so that
a slow policy loses time and no motion. (lerobot's `ActionQueue` drops by the clock; with latencies above a chunk's
length all of every chunk would be over.)

A decision is begun `execute` actions after the one before, and late decisions at once. With chunks of H actions the arm
is not held as long as a decision takes no more than `execute` <= H / 2 steps, or H / 2 where it is late.
"""

from dataclasses import dataclass, field

import numpy as np


@dataclass(slots=True)
class Course:
    """One episode's."""

    execute: int
    """Actions from one decision to the next."""
    position: int = 0
    """Actions executed."""
    _chunk: np.ndarray | None = None
    _begins: int = 0
    _observed: int | None = field(default=None)

    def wants(self) -> bool:
        """Whether it is time for another decision."""
        return self._observed is None or self.position - self._observed >= self.execute

    def observe(self) -> None:
        """A decision is begun on what is seen now."""
        self._observed = self.position

    def take(self, chunk: np.ndarray) -> int:
        """The chunk (H, A) of the decision that was begun last has arrived; how many of its actions are over."""
        assert self._observed is not None
        self._chunk, self._begins = chunk, self._observed
        return self.position - self._begins

    @property
    def begun(self) -> bool:
        """Whether there was a chunk yet."""
        return self._chunk is not None

    def next(self) -> np.ndarray | None:
        """The action (A,) that is due, which then counts as executed; None: hold."""
        place = self.position - self._begins
        if self._chunk is None or place >= len(self._chunk):
            return None
        self.position += 1
        return self._chunk[place]
