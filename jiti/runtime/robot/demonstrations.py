"""Demonstrations of an arm in a folder: which are there, and what is told of them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from jiti.errors import UsageError
from jiti.runtime.robot.recording import TICKS
from jiti.runtime.robot.take import ENTER, HAND, TIME
from jiti.runtime.rollout.result import RECORDING_SUFFIX
from jiti.runtime.sim.record import recorded_metadata


@dataclass(frozen=True, slots=True)
class Demonstration:
    """One recording, as its metadata has it."""

    path: Path
    seed: int
    how: str
    ended: str
    steps: int
    kept: bool
    """Whether it was there before this run."""

    @property
    def stopped(self) -> bool:
        """Whether it was ended in the middle by something that no one demonstrated."""
        return self.ended not in (ENTER, TIME, HAND)


def path_of(folder: Path, task_id: str, seed: int) -> Path:
    return folder / f"{task_id.replace('/', '-')}_{seed:04d}{RECORDING_SUFFIX}"


def read(path: Path, about: Mapping[str, str], *, kept: bool) -> Demonstration | None:
    """None where there is nothing. Raises UsageError for a recording with another task or robot than `about` has, or
    of something else."""
    if not path.exists():
        return None
    found = recorded_metadata(path)
    other = [f"{key} {found.get(key)!r} and not {value!r}" for key, value in about.items() if found.get(key) != value]
    if "ended" not in found or "how" not in found or other:
        what = f"was recorded with {', '.join(other)}" if other and "how" in found else "is no demonstration of an arm"
        raise UsageError(
            f"{path} {what}, and recordings are not replaced. Choose another folder with --out, or move that file away."
        )
    return Demonstration(path, int(found["seed"]), found["how"], found["ended"], int(found["steps"]), kept)


def delete(path: Path) -> None:
    """With its table."""
    path.unlink()
    path.with_suffix(TICKS).unlink(missing_ok=True)


@dataclass(frozen=True)
class Demonstrations:
    """What is there when `jiti record --robot` ends."""

    folder: Path
    task: str
    robot: str
    wanted: int
    misread: int
    """Exchanges with the servos of the arm that had to be tried again."""
    episodes: Sequence[Demonstration]

    def to_json(self) -> str:
        content = asdict(self) | {"folder": str(self.folder)}
        content["episodes"] = [asdict(one) | {"path": str(one.path)} for one in self.episodes]
        return json.dumps(content, indent=2)

    def print(self) -> None:
        """Lines on standard output."""
        kept = sum(one.kept for one in self.episodes)
        print(f"{self.folder}: {len(self.episodes)} of {self.wanted} episodes; {kept} were there before.")
        for one in self.episodes:
            if one.stopped:
                print(f"{one.path.name} was stopped in the middle ({one.ended}); delete it to have it recorded anew.")
        if self.misread:
            print(f"{self.misread} exchanges with the servos had to be tried again")
        if self.episodes:
            print(f"`jiti annotate {self.folder}` opens them.")
