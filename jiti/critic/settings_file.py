"""Settings from a TOML file, and as JSON beside a checkpoint. An unknown key is answered with the nearest name."""

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from jiti.critic.settings import Settings
from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.tasks.toml_lines import line_of, read_toml

RECIPES = Path(__file__).parent / "recipes"
"""Files that come with the package, taken by their names."""


def read_settings(path: Path | None, asked: str = "") -> Settings:
    """The settings of a TOML file, or of a recipe of the package by its name; what it does not say is as in the paper.

    Raises UsageError, which names the line; where there is no such file it begins with what was `asked`, by default the
    flag of `jiti train-critic`.
    """
    if path is None:
        return Settings()
    if not path.is_file() and (recipe := RECIPES / f"{path}.toml").is_file():
        path = recipe
    recipes = ", ".join(sorted(file.stem for file in RECIPES.glob("*.toml")))
    content, lines = read_toml(
        path, asked or f"--config {path}", f"Pass a TOML file, or the name of a recipe: {recipes}."
    )
    return settings_from(content, lambda keys: f"{path}, line {line_of(lines, keys)}: ")


def settings_from(content: Mapping[str, Any], where: Any = lambda _keys: "") -> Settings:
    """Settings of tables of keys. `where(keys)` is put before a message. Raises UsageError."""
    made = Settings()
    sections = [known.name for known in fields(Settings)]
    for section, table in content.items():
        if section not in sections or not isinstance(table, Mapping):
            at = where((section,))
            raise UsageError(f"{at}there is no section [{section}]; {nearest(section, sections)}.")
        old = getattr(made, section)
        hints = get_type_hints(type(old))
        for key, value in table.items():
            at = where((section, key))
            if key not in hints:
                raise UsageError(f"{at}[{section}] has no key {key!r}; {nearest(key, hints)}.")
            if not _fits(value, hints[key]):
                raise UsageError(f"{at}{section}.{key} is {value!r}; it must be {_wanted(hints[key])}.")
        try:
            made = replace(made, **{section: replace(old, **table)})
        except UsageError as error:
            raise UsageError(f"{where((section,))}{error}") from error
    return made


def changed(settings: Settings, tables: Mapping[str, Any], where: Any = lambda _keys: "") -> Settings:
    """Settings with those of tables of keys in their place. Raises UsageError as `settings_from` does."""
    whole = settings_to(settings)
    for section, keys in tables.items():
        whole[section] = {**whole.get(section, {}), **keys}
    return settings_from(whole, where)


def settings_to(settings: Settings) -> dict[str, Any]:
    """As tables of keys that `settings_from` takes; what is None is left out."""
    return {
        section: {key: value for key, value in table.items() if value is not None}
        for section, table in asdict(settings).items()
    }


def differences(old: Settings, new: Settings) -> list[str]:
    """Names of settings that differ: `loss.alpha`."""
    return [
        f"{part.name}.{key.name}"
        for part in fields(Settings)
        for key in fields(getattr(old, part.name))
        if getattr(getattr(old, part.name), key.name) != getattr(getattr(new, part.name), key.name)
    ]


def _fits(value: Any, hint: Any) -> bool:
    if get_origin(hint) is UnionType:
        return any(_fits(value, part) for part in get_args(hint))
    if get_origin(hint) is Literal:
        return isinstance(value, str)  # which texts, the record says
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, hint) and (hint is bool or not isinstance(value, bool))


def _wanted(hint: Any) -> str:
    parts = get_args(hint) if get_origin(hint) is UnionType else (hint,)
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
    return " or ".join(names[part] for part in parts if part in names) or "a text"
