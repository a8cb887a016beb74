"""A rollout as an MCAP file like a demonstration's, with its decisions as one more stream."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from jiti.episodes.mcap_writer import McapWriter
from jiti.runtime.rollout.decide import Decided
from jiti.runtime.rollout.play import Watcher
from jiti.runtime.sim.env import ElegantEnv
from jiti.runtime.sim.monitor import Outcome
from jiti.runtime.sim.record_episode import time_of_step, write_outcome, write_step

DECISIONS = "/decisions"
"""Topic of what was decided, one message a decision, at the time of the state that it was made on."""
DECISION_NAMES = ("q_t", "q_bar", "delta_q", "triggered", "chosen")
"""NaN where the critic was not asked, or there is no mean yet; `chosen` is 0 for the default."""


def write_decision(writer: McapWriter, time_ns: int, decided: Decided) -> None:
    """A decision, at the time of the state that it was made on."""
    d = decided.decision
    writer.write_vector(DECISIONS, time_ns, DECISION_NAMES, (d.q_t, d.q_bar, d.delta_q, d.triggered, d.chosen))


class Recorder(Watcher):
    """Writes to a temporary file that takes its name at `finish`; with `with`, an exception leaves no file."""

    def __init__(self, path: Path, instruction: str, about: Mapping[str, str]) -> None:
        self._writer = McapWriter(path, instruction=instruction, metadata=about, overwrite=True)

    def decided(self, env: ElegantEnv, decided: Decided) -> None:
        write_decision(self._writer, time_of_step(decided.frame), decided)

    def stepped(self, env: ElegantEnv, step: int, seen: dict[str, Any], action: np.ndarray | None) -> None:
        write_step(self._writer, step, env.scene, env.monitor, action, seen.get("pixels"))

    def finish(self, outcome: Outcome) -> None:
        """Close the file with how the episode ended. Raises SaveFailed."""
        write_outcome(self._writer, outcome)
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.discard()
