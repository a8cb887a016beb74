"""What `jiti rollout` takes where it is not told: the newest policy, critic and recorded task under a folder. And what
a critic learned from."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jiti.episodes.folder_reader import is_rollouts
from jiti.episodes.mcap_reader import SUFFIX
from jiti.errors import CatalogueError
from jiti.runtime.sim.record import recorded_metadata
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

WEIGHTS = "model.safetensors"
GUIDED = "jiti"
"""lerobot's type of a base policy and a critic in one."""
DEEPEST = 6
"""Folders below the current one that are looked into. Our choice: a run of lerobot-train has its checkpoints at 3."""


def newest_policy(root: Path) -> Path | None:
    """The checkpoint of a lerobot policy whose weights were written last; None where there is none."""
    return _newest(root, _is_policy)


def newest_critic(root: Path) -> Path | None:
    """The folder of a critic whose weights were written last; None where there is none."""
    return _newest(root, _is_critic)


def learned_tasks(critic: str | Path) -> list[str]:
    """Ids of the tasks that a critic learned from; empty where it does not say, or is not in a folder here."""
    about = _config(Path(critic)).get("dataset")
    tasks = about.get("tasks") if isinstance(about, dict) else None
    return [str(task) for task in tasks] if isinstance(tasks, list) else []


def newest_task(root: Path, catalogue: Catalogue) -> tuple[Task, Path] | None:
    """The task of simulation of the recording that was written last, and that recording; None where there is none.

    Rollouts are no recordings of a task that someone asked for.
    """
    recordings = [
        path for folder, names in _folders(root, rollouts=False) for path in _named(folder, names) if path.is_file()
    ]
    for path in sorted(recordings, key=_age):
        said = recorded_metadata(path)
        try:
            found = catalogue.task(said["task"]) if "task" in said else catalogue.match(said.get("instruction"))
        except CatalogueError:
            continue
        if found is not None and found.bddl is not None:
            return found, path
    return None


def _named(folder: Path, names: list[str]) -> list[Path]:
    return [folder / name for name in names if name.endswith(SUFFIX) and not name.startswith(".")]


def _newest(root: Path, wanted: Any) -> Path | None:
    found = [folder for folder, names in _folders(root) if WEIGHTS in names and wanted(folder)]
    return min(found, key=lambda folder: _age(folder / WEIGHTS), default=None)


def _age(path: Path) -> tuple[float, str]:
    """The newest comes first; of equals the first by name."""
    return -path.stat().st_mtime, str(path)


def _is_policy(folder: Path) -> bool:
    """lerobot's checkpoints name their type, other models do not. JITI around a policy is guided already."""
    config = _config(folder)
    kind = config.get("type")
    return isinstance(kind, str) and kind != GUIDED and isinstance(config.get("output_features"), dict)


def _is_critic(folder: Path) -> bool:
    """A run's folder: its checkpoints are for going on, and its best critic is in the folder itself."""
    config = _config(folder)
    return {"network", "sizes", "version"} <= config.keys() and folder.parent.name != "checkpoints"


def _config(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / "config.json").read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _folders(root: Path, *, rollouts: bool = True) -> Iterator[tuple[Path, list[str]]]:
    """A folder and those below it with the names of their files; no hidden ones, and no links, which runs have to
    their last checkpoint."""
    for place, names, files in os.walk(root):
        folder = Path(place)
        deep = len(folder.relative_to(root).parts) >= DEEPEST
        names[:] = [
            name
            for name in names
            if not deep and not name.startswith(".") and (rollouts or not is_rollouts(folder / name))
        ]
        yield folder, files
