"""What LIBERO looks for in an asset pack when it builds a task: files, and elements in them.

Read from hf-libero 0.1.4: `envs/objects` says which file a category of things comes from, `envs/arenas` and
`envs/problems` which room a task is in, and the task's BDDL file which regions and joints its predicates speak of.
"""

import importlib
import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jiti.errors import UsageError

FOLDERS = ("scenes", "stable_hope_objects", "stable_scanned_objects", "turbosquid_objects", "articulated_objects")
"""A pack has at least one of these."""

_FAMILIES = {
    "HopeBaseObject": "stable_hope_objects/{0}/{0}.xml",
    "GoogleScannedObject": "stable_scanned_objects/{0}/{0}.xml",
    "TurbosquidObjects": "turbosquid_objects/{0}/{0}.xml",
    "ArticulatedObject": "articulated_objects/{0}.xml",
}
"""LIBERO's base classes of things, and where each looks for a thing of some name."""

_SHOWN = {"flat_stove": "burner"}
"""Sites that LIBERO shows and hides as a thing changes, by category."""

_MOVES = frozenset({"open", "close", "turnon", "turnoff"})
"""Predicates that read or set a joint."""


@dataclass(frozen=True, slots=True)
class Element:
    """An element that LIBERO looks up in the XML of a file."""

    path: str
    """As `ElementTree.find` takes it, from the root."""
    named: str
    """For a person: `site 'contain_region'`."""
    why: str
    attributes: tuple[str, ...] = ()
    """Those of it that LIBERO reads and that have no default there."""


@dataclass(frozen=True, slots=True)
class Need:
    """A file of the pack that a task needs, by its path in the pack, and what must be in it."""

    file: str
    is_thing: bool
    """Whether it is an object or a fixture; else it is a room."""
    elements: tuple[Element, ...]
    textures: tuple[tuple[str, str], ...] = ()
    """Of a room: names of textures in it, and the file that LIBERO puts in place of each one's own."""


@dataclass(frozen=True, slots=True)
class _Room:
    file: str
    floor: str
    wall: str
    table: str
    """The body that the table's regions are added to."""
    resized: bool = False
    """Whether LIBERO sets the size of the table, by the names of its geoms."""


_ROOMS = {
    "floor": _Room("libero_floor_base_style", "light-gray", "light-gray-plaster", "floor"),
    "tabletop": _Room("libero_tabletop_base_style", "light-gray", "light-gray-plaster", "table", resized=True),
    "kitchen_tabletop": _Room(
        "libero_kitchen_tabletop_base_style", "gray-ceramic", "yellow-linen", "table", resized=True
    ),
    "living_room_tabletop": _Room(
        "libero_living_room_tabletop_base_style", "wood-plank", "light-gray-plaster", "living_room_table"
    ),
    "study_tabletop": _Room("libero_study_base_style", "light-gray", "light-gray-plaster", "study_table"),
    "coffee_table": _Room("libero_coffee_table_base_style", "wood-plank", "light-gray-plaster", "coffee_table"),
}
"""Rooms by the middle of the problem's name: `libero_kitchen_tabletop_manipulation`."""

_PLACED_BY = "LIBERO places the thing by it"
OBJECT = Element(
    "worldbody/body/body[@name='object']",
    "body 'object' in an outer body of the world",
    "it is all that LIBERO takes of the file",
)
_THING = (
    OBJECT,
    *(
        Element(f"worldbody/body/site[@name='{name}']", f"site '{name}' beside the body 'object'", _PLACED_BY, ("pos",))
        for name in ("bottom_site", "top_site", "horizontal_radius_site")
    ),
)


def parse_problem(file: Path) -> dict[str, Any]:
    """A BDDL file as LIBERO reads it. LIBERO must have been imported."""
    return importlib.import_module("libero.libero.envs.bddl_utils").robosuite_parse_problem(str(file))


def scene_of(problem: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    """What is alike for problems that are built from the same things: the room, and the names of all things in it."""
    things = (name for kind in ("fixtures", "objects") for names in problem[kind].values() for name in names)
    return problem["problem_name"], tuple(sorted(things))


def needs_of(problem: dict[str, Any]) -> Iterator[Need]:
    """Everything that LIBERO opens for a problem. LIBERO must have been imported.

    Raises UsageError for a room that LIBERO does not have.
    """
    yield _room(problem)
    classes = importlib.import_module("libero.libero.envs.objects").OBJECTS_DICT
    for kind in ("fixtures", "objects"):
        for category, names in problem[kind].items():
            if category in classes:  # the floor and the tables are part of the room
                elements = (e for name in names for e in _elements(problem, category, name))
                yield Need(_file_of(classes[category]), is_thing=True, elements=tuple(dict.fromkeys(elements)))


def _room(problem: dict[str, Any]) -> Need:
    name = problem["problem_name"].removeprefix("libero_").removesuffix("_manipulation")
    if name not in _ROOMS:
        raise UsageError(
            f"LIBERO 0.1.4 has no room for a problem {problem['problem_name']!r}; it has: {', '.join(_ROOMS)}"
        )
    room = _ROOMS[name]
    style = importlib.import_module("libero.libero.envs.arenas.style")
    elements = [
        Element(f"asset/texture[@name='{texture}']", f"texture '{texture}'", "LIBERO sets its file", ("file",))
        for texture in ("texplane", "tex-wall")
    ]
    elements.append(Element(f"worldbody/body[@name='{room.table}']", f"body '{room.table}'", "regions are added to it"))
    if room.resized:
        elements.append(Element("worldbody/geom[@name='floor']", "geom 'floor' in the world", "LIBERO sets its place"))
        parts = ["geom:table_collision", "geom:table_visual", "site:table_top"]
        parts += [f"geom:table_leg{k}_visual" for k in (1, 2, 3, 4)]
        for tag, _, part in (p.partition(":") for p in parts):
            path = f"worldbody/body[@name='table']/{tag}[@name='{part}']"
            elements.append(Element(path, f"{tag} '{part}' in the body 'table'", "LIBERO sets its size or place"))
    files = (style.FLOOR_STYLE[room.floor], style.WALL_STYLE[room.wall])
    textures = tuple(zip(("texplane", "tex-wall"), files, strict=True))
    return Need(f"scenes/{room.file}.xml", is_thing=False, elements=tuple(elements), textures=textures)


def _elements(problem: dict[str, Any], category: str, name: str) -> Iterator[Element]:
    """What a problem wants of one thing."""
    yield from _THING
    if category in _SHOWN:
        site = _SHOWN[category]
        yield Element(_inside(f"site[@name='{site}']"), f"site '{site}'", "LIBERO shows and hides it", ("rgba",))
    moved = {state[1] for state in (*problem["initial_state"], *problem["goal_state"]) if state[0] in _MOVES}
    if name in moved:
        yield Element(_inside("body/joint"), "joint in the body 'object'", f"the task moves or reads {name}")
    for region, properties in problem["regions"].items():
        if properties["target"] != name:
            continue
        site = region.removeprefix(f"{name}_")
        path = _inside(f"site[@name='{site}']")
        yield Element(
            path, f"site '{site}' in the body 'object'", f"it is the region {region}", ("pos", "quat", "size")
        )
        if region in moved:
            path = _inside(f"body[joint]/site[@name='{site}']")
            yield Element(path, f"joint in the body of the site '{site}'", f"the task moves or reads {region}")


def _inside(path: str) -> str:
    """Anywhere in the body `object`."""
    return f"worldbody/body/body[@name='object']//{path}"


def _file_of(category: type) -> str:
    family = next(_FAMILIES[base.__name__] for base in category.__mro__ if base.__name__ in _FAMILIES)
    return family.format(inspect.signature(category).parameters["obj_name"].default)
