"""A benchmark's plan from a TOML file; every mistake in it is told with its line."""

import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from jiti.critic.settings_file import RECIPES, changed, read_settings
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
from jiti.tasks.catalogue import Catalogue
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


def read_plan(plan: str | Path, catalogue: Catalogue | None = None) -> BenchmarkPlan:
    """A plan of the package by its name, or of a file. Raises UsageError, which names the line; with a catalogue also
    for tasks that cannot be played."""
    path = Path(plan)
    if path.suffix != ".toml" and (shipped := PLANS / f"{plan}.toml").is_file():
        path = shipped
    remedy = f"Pass a TOML file, or the name of a plan of the package: {', '.join(shipped_plans())}."
    content, lines = read_toml(path, f"--plan {plan}", remedy)

    def where(keys: KeyPath) -> str:
        return f"{path.name}, line {line_of(lines, keys)}: "

    made = plan_from(content, where, path.stem)
    if catalogue is not None:
        _check_tasks(made, catalogue, where(("data", "tasks")))
    return made


def plan_from(content: Mapping[str, Any], where: Where = lambda _keys: "", name: str = "plan") -> BenchmarkPlan:
    """A plan of tables of keys. `where(keys)` is put before a message. Raises UsageError."""
    known = ["title", "note", "groups", *_SECTIONS, *_LISTS]
    for key in content:
        if key not in known:
            raise UsageError(f"{where((key,))}a plan has no {key!r}; {nearest(key, known)}.")
    if "data" not in content:
        raise UsageError(f"{where(())}a plan needs a section [data] with `tasks`.")
    for key in ("title", "note"):
        if not isinstance(content.get(key, ""), str):
            raise UsageError(f"{where((key,))}{key} is {content[key]!r}; it must be a text.")
    made: dict[str, Any] = {"name": name, "title": content.get("title", name), "note": content.get("note", "")}
    for section, kind in _SECTIONS.items():
        if section in content:
            made[section] = _record(kind, content[section], (section,), where)
    for key, (target, kind) in _LISTS.items():
        entries = content.get(key, [])
        if not isinstance(entries, list):
            raise UsageError(f"{where((key,))}write [[{key}]], for there may be several.")
        made[target] = tuple(_record(kind, entry, (key, place), where) for place, entry in enumerate(entries))
    if "critic" in made:
        _check_critic(made["critic"], where)
    groups = content.get("groups", {})
    if not isinstance(groups, Mapping):
        raise UsageError(f"{where(('groups',))}groups is {groups!r}; it must be a section of lists of task ids.")
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


def _check_critic(plan: CriticPlan, where: Where) -> None:
    """Raises UsageError for a recipe that there is not, and settings that it does not have."""
    at, recipes = where(("critic", "recipe")), sorted(path.stem for path in RECIPES.glob("*.toml"))
    if plan.recipe not in recipes and not Path(plan.recipe).is_file():
        raise UsageError(f"{at}critic.recipe is {plan.recipe!r}, which is no file; {nearest(plan.recipe, recipes)}.")
    recipe = read_settings(Path(plan.recipe), f"{at}critic.recipe {plan.recipe}")
    try:
        changed(recipe, plan.settings, lambda keys: where(("critic", "settings", *keys)))
    except UsageError as error:
        raise UsageError(_ended(error)) from error


def _check_tasks(plan: BenchmarkPlan, catalogue: Catalogue, at: str) -> None:
    """Raises UsageError for a task that is not simulated or of which nothing could be judged."""
    known = {task.task_id: task for task in catalogue if task.bddl}
    for name in plan.data.tasks:
        if name not in known:
            raise UsageError(
                f"{at}{name!r} is no task of simulation; {nearest(name, known)}. --task-file FILE adds your own."
            )
        if not known[name].itcs:
            raise UsageError(
                f"{at}{name} has no ITC, so nothing would tell an elegant rollout from a successful one. Add one to "
                "its task file and pass that with --task-file."
            )
        if unjudged := [itc.itc_id for itc in known[name].itcs if not itc.goal]:
            raise UsageError(
                f"{at}{unjudged[0]} has no `goal`, so the simulator cannot decide it. Add one to its task file."
            )


def _place(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Of what a message is about, as far as the file has it."""
    if message.startswith("two columns"):
        name = message.rpartition(" ")[2]
        return ("column", max(k for k, column in enumerate(content["column"]) if column["name"] == name), "name")
    if named := re.match(r"compare\.(\w+) is '(.*?)';", message):
        side, name = named.groups()
        return ("compare", next(k for k, one in enumerate(content["compare"]) if one[side] == name), side)
    for section, key in re.findall(r"(\w+)\.([\w-]+)", message):
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
    if origin is not None:  # of mappings: the critic's settings are checked whole
        return isinstance(value, Mapping) and all(isinstance(one, Mapping) for one in value.values())
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, hint) and (hint is bool or not isinstance(value, bool))


def _wanted(hint: Any) -> str:
    if get_origin(hint) is tuple:
        return f"a list of {'whole numbers' if get_args(hint)[0] is int else 'texts'}"
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
    return names.get(hint, "a text" if get_origin(hint) is Literal else "sections of keys")
