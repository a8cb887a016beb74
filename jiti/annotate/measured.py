"""Verdicts that numbers decide: an ITC's goal, judged on recorded poses, contacts and gripper openings.

The goal is the one that the simulator judges (`jiti.tasks.goal`), but nothing of the simulator is used: no geometry, no
predicate that it traced. So this works on any recording that has the poses of the things that the goal names. What they
cannot decide is left open; the paper's VLM is right on 70.6% of process constraints and 47.8% of fine spatial ones
(supplement, G.2), so what they do decide is not asked of it.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jiti.annotate.readings import GRIPPER, Readings
from jiti.episodes.episode import Episode, loss
from jiti.errors import CatalogueError
from jiti.tasks.goal import Always, And, Atom, Goal, atoms, parse_goal
from jiti.tasks.judge import GAP, Trace, Verdict, judge
from jiti.tasks.rotation import angle_to_box, turned_rad
from jiti.tasks.task import ITC
from jiti.tasks.tolerance import ARM_M, TILT_RAD, TOLERANCE

SETTLED_M_S = 0.02
"""Slower than this a thing lies still. Our choice: twice what a resting thing creeps in a noisy pose estimate."""
SETTLED_S = 0.15
"""For so long, in seconds."""
CARRIED_M = 0.02
"""From where it stood, a thing that the hand touches is being carried or pushed. Our choice."""
CLOSES_PER_S = 0.2
"""Share of its travel in a second from which on a gripper is still closing. Our choice: one that holds gives less."""
RELEASE_S = 0.15
"""For so long nothing touches before a thing counts as let go; as `jiti.tasks.judge` at the simulator's 20 Hz."""
ARITY = {"PositionUnchanged": 1, "IsGrasping": 1, "IsOrientationAligned": 2, "IsPreciselyOn": 2, "IsOnBottomOf": 2}
OPENS = 0.04
"""Share of a gripper's travel by which it must open before what it holds is being let go. Our choice: fingers give by
a tenth of that under load."""

MEASURED_CONFIDENCE = 0.95
"""Of a verdict by numbers. Our choice: fewer than one in twenty differed from the simulator's in our runs."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A verdict by numbers."""

    satisfied: bool
    frame: int
    """Where it was decided."""
    reason: str
    """In a sentence, for a person."""


def decide_by_numbers(episode: Episode, itc: ITC, readings: Readings | None = None) -> Measured | None:
    """The verdict on an ITC, or None where the recording lacks a part, or the numbers that its goal asks for.

    Raises CatalogueError for a goal that cannot be read.
    """
    if not itc.goal or loss(episode) is not None:
        return None
    readings = readings or Readings(episode)
    verdict = _judged(parse_goal(itc.goal), readings)
    if verdict is None:
        return None
    # Without shapes, how near something came is not known.
    reason = re.sub(r"; the nearest came to .*", ".", verdict.reason)
    return Measured(verdict.satisfied, verdict.step, f"Decided by recorded poses: {reason}")


def _judged(goal: Goal, readings: Readings) -> Verdict | None:
    """Three-valued: one part that is violated violates all, whatever the others are."""
    if isinstance(goal, And):
        verdicts = [_judged(part, readings) for part in goal.parts]
        known = [v for v in verdicts if v is not None]
        violated = [v for v in known if not v.satisfied]
        if violated:
            return min(violated, key=lambda v: v.step)
        return max(known, key=lambda v: v.step) if known and len(known) == len(verdicts) else None
    holds: dict[str, np.ndarray] = {}
    measures: dict[str, np.ndarray] = {}
    watched = {atom: seen for atom in atoms(goal) if (seen := _watch(atom, readings)) is not None}
    if len(watched) < len(atoms(goal)):
        verdict = _judged(Always(tuple(watched)), readings) if isinstance(goal, Always) and watched else None
        return verdict if verdict is not None and not verdict.satisfied else None
    for atom, seen in watched.items():
        holds[str(atom)] = seen
        if isinstance(goal, Always) and (gap := _gap_m(atom.arguments[0], readings)) is not None:
            measures[f"{atom} {GAP}"] = gap
        if (grasp := _is_grasping(atom.arguments[0], readings)) is not None:
            holds[str(atom.grasp)] = grasp
    release = max(1, round(RELEASE_S * readings.rate_hz))
    return judge(goal, Trace(holds, measures), release_steps=release)


def _watch(atom: Atom, readings: Readings) -> np.ndarray | None:
    """(frames,) bool: whether a predicate holds; None where numbers do not tell."""
    tolerance = TOLERANCE.get(atom.predicate) if atom.tolerance is None else atom.tolerance
    watch: Mapping[str, Any] = {
        "PositionUnchanged": _position_unchanged,
        "IsOrientationAligned": _is_orientation_aligned,
        "IsPreciselyOn": _is_precisely_on,
        "IsOnBottomOf": _is_on_bottom_of,
        "IsGrasping": lambda thing, within, readings: _is_grasping(thing, readings),
    }
    if atom.predicate not in watch or tolerance is None:
        return None
    if len(atom.arguments) != ARITY[atom.predicate]:
        raise CatalogueError(f"{atom.predicate} takes {ARITY[atom.predicate]} things, and not those of ({atom})")
    return watch[atom.predicate](*atom.arguments, tolerance, readings)


def _position_unchanged(thing: str, within_m: float, readings: Readings) -> np.ndarray | None:
    place, rotation = readings.position_m(thing), readings.rotation(thing)
    if place is None or rotation is None:
        return None
    moved_m = np.linalg.norm(place - place[0], axis=1) + ARM_M * turned_rad(rotation, rotation[0])
    return moved_m <= within_m


def _is_orientation_aligned(thing: str, region: str, within_rad: float, readings: Readings) -> np.ndarray | None:
    one = readings.rotation(thing)
    other = readings.rotation(region)
    if other is None:  # a compartment is parallel to the thing that it is in
        other = readings.rotation(readings.owner(region))
    if one is None or other is None:
        return None
    return np.array([angle_to_box(a, b) <= within_rad for a, b in zip(one, other, strict=True)])


def _is_precisely_on(thing: str, target: str, within_m: float, readings: Readings) -> np.ndarray | None:
    place, goal, rotation = readings.position_m(thing), readings.position_m(target), readings.rotation(thing)
    touching = readings.touching(thing, target)
    if place is None or goal is None or rotation is None or touching is None:
        return None
    upright = rotation @ rotation[0][2]  # (frames, 3): where the axis that pointed up points now
    level = np.arccos(np.clip(upright[:, 2], -1, 1)) <= TILT_RAD
    return (np.linalg.norm((place - goal)[:, :2], axis=1) <= within_m) & level & touching


def _is_on_bottom_of(thing: str, support: str, within_m: float, readings: Readings) -> np.ndarray | None:
    """Whether it is no higher than that over where it comes to rest on the support; never, where it does not."""
    place, touching = readings.position_m(thing), readings.touching(thing, support)
    if place is None or touching is None:
        return None
    resting = _settled(place, readings.rate_hz) & touching
    grasp = readings.touching(GRIPPER, thing)
    if grasp is not None:
        resting &= ~grasp
    if not resting[-1]:
        return np.zeros(readings.frames, dtype=bool)
    return place[:, 2] - place[-1, 2] <= within_m


def _is_grasping(thing: str, readings: Readings) -> np.ndarray | None:
    """Touched by a gripper that is closed on it: until that opens from the least it was open since it touched."""
    touching, opening = readings.touching(GRIPPER, thing), readings.opening
    if touching is None or opening is None:
        return None
    holding = np.zeros(readings.frames, dtype=bool)
    least = np.inf
    for frame in range(readings.frames):
        least = min(least, opening[frame]) if touching[frame] else np.inf
        closing = frame > 0 and (opening[frame - 1] - opening[frame]) * readings.rate_hz > CLOSES_PER_S
        holding[frame] = touching[frame] and not closing and opening[frame] <= least + OPENS
    return holding


def _gap_m(neighbour: str, readings: Readings) -> np.ndarray | None:
    """(frames,): from what is carried or pushed to something that should stay, between their origins, seen from above.

    Where nothing is carried, from the hand. Shapes are not known, so this says when it came nearest and not how near.
    """
    place = readings.position_m(neighbour)
    if place is None:
        return None
    gaps = []
    for thing in readings.things:
        grasp, other = readings.touching(GRIPPER, thing), readings.position_m(thing)
        if thing != neighbour and grasp is not None and other is not None:
            moved = np.linalg.norm(other - other[0], axis=1) > CARRIED_M
            gaps.append(np.where(grasp & moved, np.linalg.norm((other - place)[:, :2], axis=1), np.inf))
    gap = np.minimum.reduce(gaps) if gaps else np.full(readings.frames, np.inf)
    if np.isfinite(gap).any():
        return gap
    hand = readings.hand_m
    return None if hand is None else np.linalg.norm((hand - place)[:, :2], axis=1)


def _settled(place: np.ndarray, rate_hz: float) -> np.ndarray:
    """(frames,) bool: slower than `SETTLED_M_S` over the last `SETTLED_S`."""
    back = max(1, round(SETTLED_S * rate_hz))
    before = place[np.maximum(np.arange(len(place)) - back, 0)]
    return np.linalg.norm(place - before, axis=1) * rate_hz / back <= SETTLED_M_S
