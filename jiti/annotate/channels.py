"""Which numbers of a recording say what the robot did: grippers, contacts, forces and motion, found by name."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from jiti.episodes.episode import Stream

Role = Literal["gripper", "contact", "force", "motion"]

GRIPPER = frozenset({"gripper", "grippers", "finger", "fingers", "jaw", "jaws", "claw", "hand", "hands"})
FINGER = frozenset({"finger", "fingers", "jaw", "jaws"})
CONTACT = frozenset({"contact", "contacts", "touch", "tactile", "bumper"})
FORCE = frozenset({"force", "forces", "wrench", "ft"})
END_EFFECTOR = frozenset({"eef", "ee", "tcp", "effector", "flange", "wrist", "hand", "gripper"})
JOINTS = frozenset({"joint", "joints", "qpos", "state", "states"})
COMMANDED = frozenset(
    {"action", "actions", "command", "commands", "cmd", "target", "desired", "goal", "leader", "ctrl"}
)
NOT_POSITION = frozenset(
    {"velocity", "velocities", "vel", "qvel", "speed", "effort", "torque", "current", "acceleration", "acc"}
    | {"temperature", "voltage", "moment"}
)
NOT_PLACE = frozenset({"orientation", "rotation", "rot", "quat", "quaternion", "angular", "rpy", "euler"})
NOT_ROBOT = frozenset({"eye", "camera", "cube", "object", "objects", "environment", "index", "timestamp"})
JUDGED = frozenset({"predicates", "measures"})
"""What a simulator made of a state, and not the state."""
SIDES = frozenset({"left", "right"})

MAX_SWITCHES = 8
"""Contacts up to this many are told apart, more are taken as one: a tactile skin. Our choice."""

METRES = 0.15
"""A finger that never stands further out than this is measured in metres. Our choice: parallel grippers open to
0.02 to 0.10 m, while finger joints in radians, degrees or per cent go far beyond."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Components of one numeric stream that belong together: one gripper, one arm, one contact."""

    role: Role
    stream: str
    columns: tuple[int, ...]
    side: str = ""
    """`left` or `right` where the names say so."""
    commanded: bool = False
    """What was asked of the robot, not what was measured."""
    opens: Literal["up", "down", "unknown"] = "unknown"
    """For a gripper: whether larger numbers are more open."""

    @property
    def label(self) -> str:
        return f"{self.stream} ({self.side})" if self.side else self.stream


def words(name: str) -> tuple[str, ...]:
    """The words of a name, lower case: `kLeftHandThumb.pos` is k, left, hand, thumb, pos."""
    return tuple(word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name))


def find_channels(streams: Mapping[str, Stream]) -> tuple[Channel, ...]:
    """The channels worth reading. Measured ones replace commanded ones of the same role and side, and the
    end effector's place replaces the joints' angles as the measure of motion."""
    numeric = [s for s in streams.values() if s.kind == "numeric" and s.shape and s.count > 1]
    found = [channel for stream in numeric for channel in _of_stream(stream)]
    motion = _first([_end_effector(s) for s in numeric], [_joints(s, found) for s in numeric])
    found += motion
    measured = {(c.role, c.side) for c in found if not c.commanded}
    roles = {role for role, _ in measured}
    return tuple(
        c for c in found if not c.commanded or not ((c.role, c.side) in measured or (not c.side and c.role in roles))
    )


def is_place(stream: Stream, channel: Channel) -> bool:
    """Whether a channel is x, y and z, in this order; three joints are none."""
    last = [words(stream.names[column])[-1:] for column in channel.columns if column < len(stream.names)]
    return last == [("x",), ("y",), ("z",)]


def _of_stream(stream: Stream) -> Iterable[Channel]:
    """Grippers, contacts and forces of one stream."""
    outer = set(words(stream.name))
    if outer & JUDGED:
        return
    groups: dict[tuple[Role, str], list[int]] = {}
    inner = _component_words(stream)
    for column, own in enumerate(inner):
        every = outer | own
        if every & CONTACT:
            groups.setdefault(("contact", _side(every)), []).append(column)
        elif every & FORCE and not own & NOT_POSITION:
            groups.setdefault(("force", _side(every)), []).append(column)
        elif every & NOT_ROBOT or outer & NOT_POSITION:
            continue
        elif every & GRIPPER and not own & (NOT_POSITION | NOT_PLACE) and not own & {"x", "y", "z", "w"}:
            groups.setdefault(("gripper", _side(every)), []).append(column)
    if _is_pair_of_fingers(groups, inner):
        pair = groups.pop(("gripper", "left")) + groups.pop(("gripper", "right"))
        groups["gripper", ""] = sorted(pair)
    commanded = bool(outer & COMMANDED)
    for (role, side), columns in groups.items():
        names = outer.union(*(inner[c] for c in columns))
        opens = _opens(names, len(columns), commanded=commanded) if role == "gripper" else "unknown"
        apart = [[c] for c in columns] if role == "contact" and len(columns) <= MAX_SWITCHES else [columns]
        for together in apart:
            yield Channel(role, stream.name, tuple(together), side, commanded, opens)


def _opens(names: set[str], size: int, *, commanded: bool) -> Literal["up", "down", "unknown"]:
    """Which way a gripper's numbers open it, from its names alone."""
    if names & {"open", "opening", "width", "aperture", "openness"}:
        return "up"
    if names & {"closed", "closing", "closure", "close"}:
        return "down"
    # LeRobot's arms (SO100, Koch, ALOHA) count from closed to open; hands of several joints have no convention.
    return "up" if size == 1 and "gripper" in names and not commanded else "unknown"


def _is_pair_of_fingers(groups: Mapping[tuple[Role, str], list[int]], inner: list[set[str]]) -> bool:
    """Left and right are the two fingers of one gripper when each side has one, named finger or jaw."""
    pair = groups.get(("gripper", "left"), []), groups.get(("gripper", "right"), [])
    return all(len(side) == 1 and inner[side[0]] & FINGER for side in pair)


def _end_effector(stream: Stream) -> list[Channel]:
    """The place of an end effector: three columns that end in x, y, z, for each side."""
    outer = set(words(stream.name))
    groups: dict[str, list[int]] = {}
    if outer & (NOT_ROBOT | NOT_POSITION | FORCE | CONTACT | COMMANDED):
        return []
    for column, own in enumerate(_component_words(stream)):
        if (outer | own) & END_EFFECTOR and own & {"x", "y", "z"} and not own & (NOT_PLACE | NOT_POSITION):
            groups.setdefault(_side(outer | own), []).append(column)
    return [Channel("motion", stream.name, tuple(c), side) for side, c in groups.items() if len(c) == 3]


def _joints(stream: Stream, found: list[Channel]) -> list[Channel]:
    """The joints of an arm, for each side: what is no gripper in a stream of states or commands."""
    outer = set(words(stream.name))
    if outer & (NOT_ROBOT | NOT_POSITION | FORCE | CONTACT) or not outer & (JOINTS | COMMANDED):
        return []
    taken = {column for c in found if c.stream == stream.name for column in c.columns}
    groups: dict[str, list[int]] = {}
    for column, own in enumerate(_component_words(stream)):
        if column not in taken and not own & (NOT_POSITION | GRIPPER | NOT_ROBOT):
            groups.setdefault(_side(outer | own), []).append(column)
    commanded = bool(outer & COMMANDED)
    return [Channel("motion", stream.name, tuple(c), side, commanded) for side, c in groups.items()]


def _first(*choices: list[list[Channel]]) -> list[Channel]:
    """The first of several ways to find channels that found any."""
    return next((flat for found in choices if (flat := [c for channels in found for c in channels])), [])


def _component_words(stream: Stream) -> list[set[str]]:
    """Words of each component's name; empty where the recording names none."""
    size = stream.shape[0]
    return [set(words(stream.names[k])) if k < len(stream.names) else set() for k in range(size)]


def _side(names: set[str]) -> str:
    """`left` or `right` when exactly one of them is named."""
    sides = names & SIDES
    return sides.pop() if len(sides) == 1 else ""
