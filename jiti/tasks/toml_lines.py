"""On which line of a TOML file a table or key stands, which the standard library's parser does not tell."""

import re
import tomllib
from pathlib import Path
from typing import Any

from jiti.errors import UsageError

KeyPath = tuple[str | int, ...]
"""Keys and places in arrays of tables: `("task", 0, "itc", 1, "criterion")`."""

_KEY = re.compile(r"""\s*(?:"((?:[^"\\]|\\.)*)"|'([^']*)'|([A-Za-z0-9_-]+))\s*""")
_OPAQUE = re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|\#[^\n]*', re.DOTALL)
"""Strings and comments, in which brackets and line ends mean nothing."""


def read_toml(path: Path, asked: str, remedy: str) -> tuple[dict[str, Any], dict[KeyPath, int]]:
    """A file's tables, and the line of each. Raises UsageError, which begins with what was `asked`: `--config FILE`."""
    try:
        text = path.read_text("utf-8")
        content = tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"{asked} cannot be read: {error.strerror}. {remedy}") from error
    except ValueError as error:
        raise UsageError(f"{asked} is no TOML: {error}.") from error
    return content, line_numbers(text)


def line_numbers(text: str) -> dict[KeyPath, int]:
    """Lines, counted from 1, of every table and key in a document that is valid TOML.

    Keys inside inline tables are not told apart: they stand where the key that holds them begins.
    """
    lines: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
    place = 0
    while place < len(text):
        line = text.count("\n", 0, place) + 1
        end, statement = _statement(text, place)
        if statement.startswith("["):
            many = statement.startswith("[[")
            keys = _keys(statement.lstrip("["))
            table = ()
            for number, key in enumerate(keys, 1):
                table = (*table, key)
                if number == len(keys) and many:
                    counts[table] = counts.get(table, 0) + 1
                if table in counts:
                    table = (*table, counts[table] - 1)
            lines.setdefault(table, line)
        elif statement:
            path = table
            for key in _keys(statement):
                path = (*path, key)
                lines.setdefault(path, line)
        place = end
    return lines


def line_of(lines: dict[KeyPath, int], path: KeyPath) -> int:
    """The line of a table or key (of the first one in an array of tables), or of the nearest one that holds it."""
    while path and path not in lines and (*path, 0) not in lines:
        path = path[:-1]
    return lines.get(path) or lines.get((*path, 0), 1)


def _statement(text: str, place: int) -> tuple[int, str]:
    """A header or a key with its value, which may go over several lines, from its first character on."""
    start, depth = place, 0
    while place < len(text):
        character = text[place]
        if opaque := _OPAQUE.match(text, place):
            if character == "#" and text[start:place].strip() == "":
                start = opaque.end()
            place = opaque.end()
            continue
        depth += (character in "[{") - (character in "]}")
        place += 1
        if character == "\n" and depth <= 0:
            break
    return place, text[start:place].strip()


def _keys(statement: str) -> list[str]:
    """The dotted key at the start of a statement."""
    keys = []
    place = 0
    while match := _KEY.match(statement, place):
        keys.append(next(group for group in match.groups() if group is not None))
        place = match.end()
        if statement[place : place + 1] != ".":
            break
        place += 1
    return keys
