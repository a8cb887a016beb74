"""The tasks that are known: the paper's, which come with the package, and a user's own files."""

import json
import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

from jiti.errors import CatalogueError
from jiti.tasks.catalogue_file import Defined, read_tasks
from jiti.tasks.generic import GENERIC, generic_task
from jiti.tasks.task import ITC, Task

if TYPE_CHECKING:
    from jiti.episodes.episode import Episode

_SCENE = re.compile(r"^[A-Z]+(?:_[A-Z]+)*_SCENE\d+_")
"""What LIBERO puts before an instruction in the names of its files."""


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Tasks with unique ids. A user's come first, so that they are the ones that instructions are matched to."""

    tasks: tuple[Task, ...]
    _by_wording: dict[str, Task] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        for task in self.tasks:
            wordings = [task.instruction, *task.aliases]
            if task.bddl:
                name = task.bddl.rpartition("/")[2]
                wordings += [name, _SCENE.sub("", name)]
            for wording in wordings:
                self._by_wording.setdefault(_plain(wording), task)

    def __iter__(self) -> Iterator[Task]:
        return iter(self.tasks)

    def __len__(self) -> int:
        return len(self.tasks)

    def task(self, task_id: str) -> Task:
        """The task with an id. Raises CatalogueError that names the nearest ids."""
        for task in self.tasks:
            if task.task_id == task_id:
                return task
        if task_id == GENERIC:
            return generic_task()
        known = [task.task_id for task in self.tasks]
        close = get_close_matches(task_id, known, 3) or known[:3]
        raise CatalogueError(
            f"there is no task {task_id!r}; did you mean {' or '.join(close)}? "
            "`jiti tasks` lists all, --tasks FILE adds some."
        )

    def itc(self, itc_id: str) -> ITC | None:
        """The ITC with an id; None for one that no catalogue has any more."""
        for task in (*self.tasks, generic_task()):
            for itc in task.itcs:
                if itc.itc_id == itc_id:
                    return itc
        return None

    def match(self, instruction: str | None) -> Task | None:
        """The first task of that wording, whatever its case, punctuation, spaces, `_` or `-`; None without one."""
        return self._by_wording.get(_plain(instruction)) if instruction and _plain(instruction) else None

    def simulated(self, name: str) -> Task:
        """The task of simulation with an id, or the only one whose id ends in `/name`. Raises CatalogueError."""
        tasks = [task for task in self.tasks if task.bddl]
        found = ids_named(name, [task.task_id for task in tasks])
        if len(found) == 1:
            return self.task(found[0])
        ids = found or [task.task_id for task in tasks]
        close = get_close_matches(name, [*ids, *(i.rpartition("/")[2] for i in ids)], 3, 0.5)
        hint = f"did you mean {' or '.join(close)}? " if close and not found else ""
        what = f"{name!r} is the end of several tasks' ids" if found else f"no task of simulation is {name!r}"
        if any(name in (task.task_id, task.task_id.rpartition("/")[2]) for task in self.tasks if not task.bddl):
            hint = "it is a task of an arm: `jiti rollout --robot so100` plays it. "
        raise CatalogueError(f"{what}; {hint}{'There' if hint else 'there'} are: {', '.join(ids)}.")

    def for_episode(self, episode: "Episode") -> Task:
        """The task that its recorder named, else the one that matches its instruction, else a generic one."""
        for task in self.tasks:
            if task.task_id == episode.task_id:
                return task
        return self.for_instruction(episode.task)

    def for_instruction(self, instruction: str | None) -> Task:
        """The task that matches, or one with an ITC for each criterion, so that every episode can be labelled."""
        return self.match(instruction) or generic_task(instruction)


def ids_named(name: str, ids: Iterable[str]) -> list[str]:
    """The id that is the name; else those that end in `/name`: none, the one that is meant, or several."""
    known = list(ids)
    return [name] if name in known else [one for one in known if one.rpartition("/")[2] == name]


def load_catalogue(*extra: Path) -> Catalogue:
    """The package's tasks and those of a user's files. Raises CatalogueError that names file and line.

    A user's task takes the place of one of the package only where it says `replace = true`.
    """
    ours = {defined.task.task_id: defined for defined in _package()}
    users: dict[str, Defined] = {}
    for path in extra:
        for defined in read_tasks(path):
            task_id = defined.task.task_id
            where = f"{defined.path}, line {defined.line}"
            if task_id in users:
                other = users[task_id]
                raise CatalogueError(f"{where}: the task id {task_id!r} is taken by {other.path}, line {other.line}")
            if task_id in ours and not defined.replace:
                raise CatalogueError(
                    f"{where}: the task id {task_id!r} is one of the package's; choose another, "
                    "or write `replace = true` to put yours in its place"
                )
            users[task_id] = defined
            ours.pop(task_id, None)
    return Catalogue(tuple(defined.task for defined in (*users.values(), *ours.values())))


def print_catalogue(catalogue: Catalogue, *, as_json: bool = False) -> None:
    """List tasks and their ITCs on standard output."""
    if as_json:
        print(json.dumps([asdict(task) for task in catalogue], indent=2, ensure_ascii=False))
        return
    for task in catalogue:
        print(f"{task.task_id}  {task.instruction}")
        for itc in task.itcs:
            name = itc.itc_id.removeprefix(f"{task.task_id}/")
            print(f"    {name} ({itc.criterion.replace('_', ' ')}): {itc.statement}")


@cache
def _package() -> tuple[Defined, ...]:
    with as_file(files("jiti.tasks") / "catalogue") as folder:
        return tuple(defined for path in sorted(folder.glob("*.toml")) for defined in read_tasks(path))


def _plain(wording: str) -> str:
    """Letters and digits in lower case, with single spaces where anything else was."""
    text = unicodedata.normalize("NFKC", _SCENE.sub("", wording.strip())).casefold()
    return " ".join(re.split(r"[\W_]+", text)).strip()
