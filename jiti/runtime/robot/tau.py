"""tau of an arm: what a wished share of decisions exceeds in episodes of their own, kept with a task's rollouts."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from jiti.durable import write_atomic
from jiti.errors import SourceError, UsageError
from jiti.runtime.guidance import calibrated_tau
from jiti.runtime.robot.recording import DECISIONS
from jiti.runtime.rollout.plan_file import TAU_FILE

REMEDY = "pass --calibrate-tau 0.339 (G.6) and some --episodes of their own, or --tau."


@dataclass(frozen=True, slots=True)
class Asked:
    """What a tau is for."""

    task: str
    robot: str
    policy: str
    """Fingerprint of its folder; a Hub id as it is."""
    critic: str
    window: int
    """k"""


@dataclass(frozen=True, slots=True)
class ArmTau:
    """A tau, and what it was measured on."""

    tau: float
    rate: float
    """Share of decisions that was to exceed it."""
    measured: float
    """Share of these decisions that did."""
    asked: Asked
    episodes: int
    decisions: int
    made: str
    """When, in UTC."""

    def __str__(self) -> str:
        return (
            f"tau {self.tau:.4g}: {self.measured:.0%} of {self.decisions} decisions in {self.episodes} episodes exceed "
            f"it; {self.rate:.0%} were to"
        )


def measure_tau(recordings: Sequence[Path], rate: float, asked: Asked) -> ArmTau:
    """Of episodes in which the critic looked and nothing was done about it; one that ended before its first decision
    has none. Raises UsageError for too few."""
    decided = [path.with_suffix(DECISIONS) for path in recordings]
    tables = [pq.read_table(path, columns=["delta_q"]) for path in decided if path.exists()]
    values = [value for table in tables for value in table["delta_q"].to_pylist()]
    delta_q = np.array([np.nan if value is None else value for value in values], float)
    tau = calibrated_tau(delta_q, rate)
    made = datetime.now(UTC).isoformat(timespec="seconds")
    return ArmTau(tau, rate, float(np.mean(delta_q > tau)), asked, len(recordings), len(delta_q), made)


def save_tau(folder: Path, found: ArmTau) -> Path:
    """Where it is kept. Raises SaveFailed."""
    path = folder / TAU_FILE
    write_atomic(path, json.dumps(asdict(found), indent=2).encode())
    return path


def stored_tau(folder: Path, asked: Asked) -> float:
    """Raises UsageError where there is none for this, SourceError for a damaged file."""
    path = folder / TAU_FILE
    if not path.exists():
        raise UsageError(f"JITI needs a threshold, and {folder} has none: {REMEDY}")
    try:
        content = json.loads(path.read_bytes())
        known, tau = Asked(**content["asked"]), float(content["tau"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path} is damaged: {error!r}. Delete it, and {REMEDY}") from error
    for name, value in asdict(asked).items():
        if getattr(known, name) != value:
            raise UsageError(f"{path} was calibrated with {name} {getattr(known, name)} and not {value}: {REMEDY}")
    return tau
