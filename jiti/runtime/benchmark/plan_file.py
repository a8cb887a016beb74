"""A benchmark's plan from a TOML file; every mistake in it is told with its line."""

import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.runtime.benchmark.plan import (
    BenchmarkPlan,
    Column,
    Comparison,
    CriticPlan,
    CuratePlan,
    DataPlan,
    PolicyPlan,
    RolloutsPlan,
    TauPlan,
)
from jiti.tasks.toml_lines import KeyPath, line_of, read_toml

PLANS = Path(__file__).parent / "plans"
"""Plans that come with the package, taken by their names."""

_SECTIONS: dict[str, type] = {
    "data": DataPlan,
    "curate": CuratePlan,
    "policy": PolicyPlan,
    "critic": CriticPlan,
    "tau": TauPlan,
    "rollouts": RolloutsPlan,
}
_LISTS: dict[str, tuple[str, type]] = {"column": ("columns", Column), "compare": ("comparisons", Comparison)}
Where = Callable[[KeyPath], str]


def shipped_plans() -> list[str]:
    """Names of the package's plans."""
    return sorted(path.stem for path in PLANS.glob("*.toml"))


def read_plan(plan: str | Path) -> BenchmarkPlan:
    """A plan of the package by its name, or of a file. Raises UsageError, which names the line."""
    path = Path(plan)
    if path.suffix != ".toml" and (shipped := PLANS / f"{plan}.toml").is_file():
        path = shipped
    remedy = f"Pass a TOML file, or the name of a plan of the package: {', '.join(shipped_plans())}."
    content, lines = read_toml(path, f"--plan {plan}", remedy)
    return plan_from(content, lambda keys: f"{path.name}, line {line_of(lines, keys)}: ", path.stem)


def plan_from(content: Mapping[str, Any], where: Where = lambda _keys: "", name: str = "plan") -> BenchmarkPlan:
    """A plan of tables of keys. `where(keys)` is put before a message. Raises UsageError."""
    known = ["title", "note", "groups", *_SECTIONS, *_LISTS]
    for key in content:
        if key not in known:
            raise UsageError(f"{where((key,))}a plan has no {key!r}; {nearest(key, known)}.")
    if "data" not in content:
        raise UsageError(f"{where(())}a plan needs a section [data] with `tasks`.")
    made: dict[str, Any] = {"name": name, "title": content.get("title", name), "note": content.get("note", "")}
    for section, kind in _SECTIONS.items():
        if section in content:
            made[section] = _record(kind, content[section], (section,), where)
    for key, (target, kind) in _LISTS.items():
        entries = content.get(key, [])
        if not isinstance(entries, list):
            raise UsageError(f"{where((key,))}write [[{key}]], for there may be several.")
        made[target] = tuple(_record(kind, entry, (key, place), where) for place, entry in enumerate(entries))
    groups = content.get("groups", {})
    for group, tasks in groups.items():
        if not _fits(tasks, tuple[str, ...]):
            raise UsageError(f"{where(('groups', group))}groups.{group} is {tasks!r}; it must be a list of task ids.")
    made["groups"] = {group: tuple(tasks) for group, tasks in groups.items()}
    try:
        return BenchmarkPlan(**made)
    except UsageError as error:
        raise UsageError(f"{where(_place(str(error), content))}{_ended(error)}") from error


def _record(kind: type, table: Any, keys: KeyPath, where: Where) -> Any:
    name = str(keys[0])
    if not isinstance(table, Mapping):
        raise UsageError(f"{where(keys)}{name} is {table!r}; it must be a section of keys.")
    hints = get_type_hints(kind)
    values: dict[str, Any] = {}
    for key, value in table.items():
        at = where((*keys, key))
        if key not in hints:
            raise UsageError(f"{at}{name} has no key {key!r}; {nearest(key, hints)}.")
        if not _fits(value, hints[key]):
            raise UsageError(f"{at}{name}.{key} is {value!r}; it must be {_wanted(hints[key])}.")
        values[key] = tuple(value) if isinstance(value, list) else value
    for one in fields(kind):
        if one.name not in values and one.default is MISSING and one.default_factory is MISSING:
            raise UsageError(f"{where(keys)}{name} lacks the key {one.name!r}.")
    try:
        return kind(**values)
    except UsageError as error:
        named = str(error).split(" ", 1)[0].rpartition(".")[2]
        raise UsageError(f"{where((*keys, named))}{_ended(error)}") from error


def _place(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Of what a message is about, as far as the file has it."""
    if message.startswith("two columns"):
        name = message.rpartition(" ")[2]
        return ("column", max(k for k, column in enumerate(content["column"]) if column["name"] == name), "name")
    if message.startswith("compare"):
        return ("compare",)
    for section, key in re.findall(r"(\w+)\.(\w+)", message):
        if key in content.get(section, {}):
            return section, key
    return ()


def _ended(error: UsageError) -> str:
    return str(error) if str(error).endswith(".") else f"{error}."


def _fits(value: Any, hint: Any) -> bool:
    origin = get_origin(hint)
    if origin is UnionType:
        return any(_fits(value, part) for part in get_args(hint))
    if origin is Literal:
        return isinstance(value, str)  # which texts, the record says
    if origin is tuple:
        return isinstance(value, list | tuple) and all(_fits(one, get_args(hint)[0]) for one in value)
    if origin is not None:  # of mappings: the critic's settings check their own
        return isinstance(value, Mapping) and all(isinstance(one, Mapping) for one in value.values())
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, hint) and (hint is bool or not isinstance(value, bool))


def _wanted(hint: Any) -> str:
    if get_origin(hint) is tuple:
        return f"a list of {'whole numbers' if get_args(hint)[0] is int else 'texts'}"
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
    return names.get(hint, "a text" if get_origin(hint) is Literal else "sections of keys")
