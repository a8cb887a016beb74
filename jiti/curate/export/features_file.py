"""A feature mapping as a TOML file, and the automatic one written as such.

[features."observation.state"]
streams = ["/joint_states"]
components = ["joint1.position", "joint2.position"]

[features."observation.images.front"]
camera = "/camera/front"
"""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jiti.curate.export.features import Feature
from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.tasks.toml_lines import KeyPath, line_numbers, line_of

_KEYS = {"streams": list, "components": list, "camera": str, "scene_state": bool}


def read_features(path: Path) -> tuple[Feature, ...]:
    """The features of a file. Raises UsageError that names file and line."""
    try:
        text = path.read_text()
        content = tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"--features {path} cannot be read: {(error.strerror or str(error)).lower()}.") from error
    except ValueError as error:  # UnicodeDecodeError and TOMLDecodeError
        raise UsageError(f"--features {path} is not valid TOML: {error}.") from error
    lines = line_numbers(text)

    def wrong(at: KeyPath, what: str) -> UsageError:
        return UsageError(f"{path}, line {line_of(lines, at)}: {what}")

    if unknown := [key for key in content if key != "features"]:
        raise wrong((unknown[0],), f'there is no key {unknown[0]!r}; write [features."observation.state"] and so on.')
    tables = content.get("features")
    if not isinstance(tables, dict) or not tables:
        raise wrong((), "there is no [features.NAME] in it. --print-features shows how it looks.")
    found = []
    for key, table in tables.items():
        at = ("features", key)
        if not isinstance(table, dict):
            raise wrong(at, f"{key!r} is {table!r}; it must be a table with streams, camera or scene_state.")
        for name, value in table.items():
            if name not in _KEYS:
                raise wrong((*at, name), f"a feature has no key {name!r}; {nearest(name, _KEYS)}.")
            if not _fits(value, _KEYS[name]):
                kind = {list: "a list of texts", str: "a text", bool: "true or false"}[_KEYS[name]]
                raise wrong((*at, name), f"{name} is {value!r}; it must be {kind}.")
        try:
            found.append(
                Feature(
                    key,
                    tuple(table.get("streams", ())),
                    tuple(table.get("components", ())),
                    table.get("camera"),
                    table.get("scene_state", False),
                )
            )
        except UsageError as error:
            raise wrong(at, str(error)) from error
    return tuple(found)


def features_toml(features: Sequence[Feature], title: str, comments: Sequence[str] = ()) -> str:
    """The file that gives these features; `title` says of which recording they are, comments follow."""
    lines = [f"# Features of {title}. Change them and pass this file with --features."]
    if comments:
        lines += ["# Of other recordings the automatic ones differ:", *comments]
    for feature in features:
        lines += ["", f"[features.{json.dumps(feature.key)}]"]
        if feature.streams:
            lines.append(f"streams = {json.dumps(feature.streams, ensure_ascii=False)}")
        if feature.components:
            lines.append(f"components = {json.dumps(feature.components, ensure_ascii=False)}")
        if feature.camera is not None:
            lines.append(f"camera = {json.dumps(feature.camera, ensure_ascii=False)}")
        if feature.scene_state:
            lines.append("scene_state = true")
    return "\n".join(lines) + "\n"


def _fits(value: Any, kind: type) -> bool:
    if kind is list:
        return isinstance(value, list) and bool(value) and all(isinstance(item, str) and item for item in value)
    return isinstance(value, kind) and value != ""
