"""What a work folder remembers: finished stages, and the runs that worked in it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from jiti.durable import make_folder, write_atomic
from jiti.errors import SourceError
from jiti.revision import git_revision
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.rollout.plan_file import versions
from jiti.runtime.rollout.result import RECORDING_SUFFIX, RESULT_SUFFIX

FOLDERS = {
    "record": "recordings",
    "curate": "datasets",
    "critics": "critics",
    "values": "values",
    "policies": "policies",
    "tau": "calibrations",
    "rollouts": "rollouts",
}
"""Of the kinds of stages; labels are with the recordings."""
RUNNING, KILLED = "running", "killed"
"""How a run ended that did not, and one that could not say."""
_THERE = "there"
"""Of a run that has not ended: how many files of rollouts there were when it began."""


@dataclass(frozen=True, slots=True)
class Mark:
    """That a stage is finished, and what it came to."""

    kind: str
    name: str
    key: str
    inputs: Mapping[str, Any]
    needs: list[str]
    wall_s: float
    made: Mapping[str, Any]
    """Figures for the report."""
    finished: str
    """UTC."""
    revision: str | None = None
    """Of the code that made it; None outside a checkout."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Of the packages; empty in marks of an older jiti."""


@dataclass(frozen=True, slots=True)
class Work:
    """A work folder. `flat` is for recordings of one task in the folder itself, as `jiti demo` leaves them."""

    out: Path
    flat: bool = False

    def folder(self, stage: Stage) -> Path:
        """Where a stage's output is."""
        if stage.kind == "autolabel":
            return self.folder(stage.needs[0]) / "labels"
        if stage.kind == "record" and self.flat:
            return self.out
        if stage.kind == "record":  # recordings of one plan side by side, called by their task alone
            return self.out / FOLDERS[stage.kind] / stage.key / stage.name
        return self.out / FOLDERS[stage.kind] / stage.folder

    def done(self, stage: Stage) -> Mark | None:
        """Raises SourceError for a mark that cannot be read."""
        path = self._mark(stage)
        if not path.exists() or not self.folder(stage).exists():
            return None
        try:
            return Mark(**json.loads(path.read_bytes()))
        except (OSError, ValueError, TypeError) as error:
            raise SourceError(f"{path} is damaged: {error!r}. Delete it, and the stage is done again.") from error

    def finish(self, stage: Stage, wall_s: float, made: Mapping[str, Any]) -> None:
        """Remember that a stage is finished. Raises SaveFailed."""
        make_folder(self.out / "stages")
        mark = Mark(
            stage.kind,
            stage.name,
            stage.key,
            stage.inputs,
            [needed.key for needed in stage.needs],
            round(wall_s, 3),
            made,
            _now(),
            *code(),
        )
        write_atomic(self._mark(stage), json.dumps(asdict(mark), indent=1).encode())

    def begin_run(self, about: Mapping[str, Any]) -> None:
        """Add a run to those of the folder, with its code, before it does anything: what is killed says nothing more.

        One that is still said to be running was killed, for no other works here. Raises SourceError, SaveFailed.
        """
        make_folder(self.out)
        revision, packages = code()
        before = [_ended(run, {"ended": KILLED}) if run.get("ended") == RUNNING else run for run in self.runs()]
        own = {"began": _now(), "revision": revision, "versions": packages, **about}
        self._write_runs([*before, own | {"ended": RUNNING, _THERE: self._results()}])

    def end_run(self, about: Mapping[str, Any]) -> None:
        """Say how the run ended that began last, and which stages of rollouts it played in. Raises SaveFailed."""
        *before, own = self.runs()
        self._write_runs([*before, _ended(own, {"finished": _now(), **about})])

    def runs(self) -> list[dict[str, Any]]:
        """The oldest first; `played` has the keys of the stages of rollouts in which a run played something, also where
        it did not come to its end. Raises SourceError."""
        path = self.out / "runs.json"
        try:
            runs = json.loads(path.read_bytes()) if path.exists() else []
        except (OSError, ValueError) as error:
            raise SourceError(f"{path} is damaged: {error!r}. Delete it.") from error
        for run in runs:
            if _THERE in run:
                run["played"] = sorted(key for key, count in self._results().items() if count > run[_THERE].get(key, 0))
        return runs

    def _write_runs(self, runs: Sequence[Mapping[str, Any]]) -> None:
        write_atomic(self.out / "runs.json", json.dumps(runs, indent=1).encode())

    def _results(self) -> dict[str, int]:
        """Files of rollouts by the key of their stage."""
        folders = (self.out / FOLDERS["rollouts"]).glob("*-*/")
        suffixes = (RESULT_SUFFIX, RECORDING_SUFFIX)
        return {
            folder.name.rpartition("-")[2]: sum(path.suffix in suffixes for path in folder.glob("*/[!.]*"))
            for folder in folders
        }

    def _mark(self, stage: Stage) -> Path:
        return self.out / "stages" / f"{stage.kind}-{stage.folder}.json"


@cache
def code() -> tuple[str | None, dict[str, str]]:
    """Revision and versions of packages of what runs here, as they were when this process first asked."""
    return git_revision(), versions()


def _ended(run: Mapping[str, Any], how: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in run.items() if key != _THERE} | dict(how)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
