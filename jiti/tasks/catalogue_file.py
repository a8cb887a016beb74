"""A task file: TOML, checked so that every mistake is answered with its line and what to write instead.

[[task]]
id = "lab/pour"
instruction = "pour the water into the glass"

[[task.itc]]
id = "nothing-spilled"
criterion = "task_sequence_integrity"
statement = "No water may land outside the glass."
check = "Look at the table around the glass after the pour."
"""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jiti.errors import CatalogueError
from jiti.nearest import nearest
from jiti.tasks.goal import parse_goal
from jiti.tasks.task import ITC, Criterion, Task
from jiti.tasks.toml_lines import KeyPath, line_numbers, line_of

_TEXT, _TABLES, _TEXTS, _FLAG = "a text", "tables", "a list of texts", "true or false"

_FILE_KEYS = {"task": (_TABLES, True)}
_TASK_KEYS = {
    "id": (_TEXT, True),
    "instruction": (_TEXT, True),
    "itc": (_TABLES, True),
    "aliases": (_TEXTS, False),
    "source": (_TEXT, False),
    "bddl": (_TEXT, False),
    "replace": (_FLAG, False),
}
_ITC_KEYS = {
    "id": (_TEXT, True),
    "criterion": (_TEXT, True),
    "statement": (_TEXT, True),
    "check": (_TEXT, False),
    "goal": (_TEXT, False),
}
_ID = re.compile(r"[A-Za-z0-9][\w.-]*")


@dataclass(frozen=True, slots=True)
class Defined:
    """A task and where it was defined."""

    task: Task
    path: Path
    line: int
    replace: bool = False
    """Whether it may take the place of a task of the package with the same id."""


def read_tasks(path: Path) -> list[Defined]:
    """The tasks of a file. Raises CatalogueError that names the line of every mistake in it."""
    text = _text(path)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise CatalogueError(f"{path}, {_syntax_error(str(error), text)}") from error
    return _Reader(path, line_numbers(text)).read(content)


class _Reader:
    def __init__(self, path: Path, lines: dict[KeyPath, int]) -> None:
        self._path = path
        self._lines = lines
        self._wrong: list[tuple[int, str]] = []

    def read(self, content: dict[str, Any]) -> list[Defined]:
        tasks: list[Defined] = []
        self._check((), content, _FILE_KEYS, "the file")
        for number, table in enumerate(_list(content, "task")):
            if defined := self._task(("task", number), table):
                self._check_new(defined, tasks)
                tasks.append(defined)
        if self._wrong:
            raise CatalogueError("\n".join(f"{self._path}, line {line}: {what}" for line, what in sorted(self._wrong)))
        return tasks

    def _task(self, at: KeyPath, table: dict[str, Any]) -> Defined | None:
        whole = self._check(at, table, _TASK_KEYS, "a task")
        task_id = table.get("id") if isinstance(table, dict) else None
        itcs: list[ITC] = []
        for number, inner in enumerate(_list(table, "itc")):
            if itc := self._itc((*at, "itc", number), inner, str(task_id)):
                if any(itc.itc_id == other.itc_id for other in itcs):
                    self._say((*at, "itc", number, "id"), f"the task has two ITCs with the id {inner['id']!r}")
                itcs.append(itc)
        if not whole:
            return None
        parts = table["id"].split("/")
        if not all(_ID.fullmatch(part) for part in parts) or parts[0] == "generic":
            self._say(
                (*at, "id"),
                f"the task id is {task_id!r}; it must be letters, digits and . _ - in parts that '/' divides, "
                "and not start with 'generic'",
            )
        if not table["itc"]:
            self._say((*at, "itc"), "the task has no ITC; give it at least one [[task.itc]]")
        task = Task(
            table["id"],
            table["instruction"],
            tuple(itcs),
            table.get("source", self._path.name),
            table.get("bddl"),
            tuple(table.get("aliases", ())),
        )
        return Defined(task, self._path, line_of(self._lines, at), table.get("replace", False))

    def _itc(self, at: KeyPath, table: dict[str, Any], task_id: str) -> ITC | None:
        if not self._check(at, table, _ITC_KEYS, "an ITC"):
            return None
        if not _ID.fullmatch(table["id"]):
            self._say((*at, "id"), f"the ITC id is {table['id']!r}; it must be letters, digits and . _ -")
            return None
        name = table["criterion"]
        if name not in list(Criterion):
            self._say((*at, "criterion"), f"there is no criterion {name!r}; {nearest(name, Criterion)}")
            return None
        goal = table.get("goal", "")
        try:
            if goal:
                parse_goal(goal)
        except CatalogueError as error:
            self._say((*at, "goal"), f"the goal cannot be read: {error}")
        return ITC(f"{task_id}/{table['id']}", table["statement"], Criterion(name), table.get("check", ""), goal)

    def _check(self, at: KeyPath, table: Any, keys: dict[str, tuple[str, bool]], what: str) -> bool:
        """Whether a table has the keys that it needs, with values of the right kind, and no others."""
        before = len(self._wrong)
        if not isinstance(table, dict):
            self._say(at, f"{what} is {table!r}; it must be a table")
            return False
        for key, value in table.items():
            if key not in keys:
                self._say((*at, key), f"{what} has no key {key!r}; {nearest(key, keys)}")
            elif wrong := _wrong_kind(value, keys[key][0]):
                self._say((*at, key), f"{key} is {_shown(value)}; {wrong}")
        for key, (_, needed) in keys.items():
            if needed and key not in table:
                header = f"[[{'.'.join(str(part) for part in (*at, key) if isinstance(part, str))}]]"
                remedy = f"add {header}" if keys[key][0] == _TABLES else f"add `{key} = ...`"
                self._say(at, f"{what} has no {key}; {remedy}")
        return len(self._wrong) == before

    def _check_new(self, defined: Defined, others: list[Defined]) -> None:
        for other in others:
            if other.task.task_id == defined.task.task_id:
                self._wrong.append(
                    (defined.line, f"the task id {defined.task.task_id!r} is taken by the task in line {other.line}")
                )

    def _say(self, at: KeyPath, what: str) -> None:
        self._wrong.append((line_of(self._lines, at), what))


def _list(table: Any, key: str) -> list[Any]:
    """What can be looked into even where the rest of a table is wrong."""
    value = table.get(key) if isinstance(table, dict) else None
    return value if isinstance(value, list) else []


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CatalogueError(
            f"{path} cannot be read as a task file: {(error.strerror or str(error)).lower()}"
        ) from error
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise CatalogueError(f"{path}, line {line}: this is not UTF-8 text; save the file as UTF-8") from error


def _syntax_error(message: str, text: str) -> str:
    """The parser's message with its line in front."""
    what, _, place = message.rpartition(" (at ")
    if found := re.match(r"line (\d+), column (\d+)", place):
        return f"line {found[1]}: {what[:1].lower()}{what[1:]} in column {found[2]}; this is not valid TOML"
    last = text.count("\n") + (not text.endswith("\n"))
    return f"line {last}: {(what or message)[:1].lower()}{(what or message)[1:]} at the end; this is not valid TOML"


def _wrong_kind(value: Any, kind: str) -> str:
    fits = {
        _TEXT: isinstance(value, str) and bool(value.strip()),
        _TABLES: isinstance(value, list),
        _TEXTS: isinstance(value, list) and all(isinstance(item, str) and item.strip() for item in value),
        _FLAG: isinstance(value, bool),
    }
    if fits[kind]:
        return ""
    return "it must not be empty" if kind == _TEXT and isinstance(value, str) else f"it must be {kind}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
