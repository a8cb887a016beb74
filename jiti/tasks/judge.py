"""Whether an ITC was satisfied, and at which step that was decided, from what was seen at every step of an episode."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from jiti.errors import CatalogueError
from jiti.tasks.goal import Always, And, AtEnd, Atom, AtRelease, Goal, Until

RELEASE_STEPS = 3
"""Steps without contact from which on a thing counts as let go; contact flickers in MuJoCo, as a prototype measured.
0.15 s at 20 Hz."""

GAP = "gap_m"
"""Suffix of a measure: the least distance of the hand, and of what it moves, to what must stay as it is."""
PREDICATES, MEASURES = "/predicates", "/measures"
"""Topics under which a recording has a trace: whether each predicate holds at each step, and what was measured."""


@dataclass(frozen=True, slots=True)
class Trace:
    """What was seen at each step of an episode, from the first state to the last."""

    holds: Mapping[str, np.ndarray]
    """(steps,) bool by predicate, under its text: `IsGrasping ketchup_1`."""
    measures: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(steps,) float by measure: `IsGrasping ketchup_1 fingers`."""

    def of(self, atom: Atom) -> np.ndarray:
        """(steps,) bool. Raises CatalogueError when the predicate was not watched."""
        try:
            return self.holds[str(atom)]
        except KeyError:
            raise CatalogueError(
                f"the trace has no {str(atom)!r}, it has: {', '.join(self.holds)}. It was recorded with other goals; "
                "record it again."
            ) from None

    @property
    def last(self) -> int:
        """The last step."""
        return len(next(iter(self.holds.values()))) - 1


@dataclass(frozen=True, slots=True)
class Verdict:
    """How an ITC was decided."""

    satisfied: bool
    step: int
    """Where, from 0: the first step of a violation, else the step after which nothing could change it any more or, for
    what must never happen, the step at which it came nearest to happening."""
    reason: str
    """In a sentence, for a person."""


def judge(goal: Goal, trace: Trace, *, release_steps: int = RELEASE_STEPS) -> Verdict:
    """The verdict on a whole episode; `release_steps` without contact let a thing go.

    Raises CatalogueError when the trace lacks a predicate of the goal.
    """
    match goal:
        case And(parts):
            verdicts = [judge(part, trace, release_steps=release_steps) for part in parts]
            violated = [v for v in verdicts if not v.satisfied]
            return min(violated, key=lambda v: v.step) if violated else max(verdicts, key=lambda v: v.step)
        case Until(stays, until):
            return _until(stays, until, trace, release_steps)
        case AtRelease(what):
            return _at_release(what, trace, release_steps)
        case AtEnd(what):
            return _at_end(what, trace, release_steps)
        case Always(what):
            return _always(what, trace)


def releases(grasping: np.ndarray, release_steps: int = RELEASE_STEPS) -> list[int]:
    """Last steps of contact before each time that a thing was let go; contact (steps,) bool, flickers bridged."""
    held = [*np.flatnonzero(grasping).tolist(), len(grasping)]
    return [a for a, b in pairwise(held) if b - a > release_steps]


def _until(stays: Atom, until: Atom, trace: Trace, release_steps: int) -> Verdict:
    if not trace.of(stays).any():
        return Verdict(False, trace.last, f"{stays} never held.")
    ends = releases(trace.of(stays), release_steps)
    if not ends:
        return Verdict(False, trace.last, f"{stays} still held at the end.")
    step = ends[0]
    if trace.of(until)[step]:
        return Verdict(True, step, f"{stays} ended when {until} held.")
    return Verdict(False, step, f"{stays} ended before {until} held.")


def _at_release(what: Atom, trace: Trace, release_steps: int) -> Verdict:
    ends = releases(trace.of(what.grasp), release_steps)
    if not ends:
        return Verdict(False, trace.last, f"{what.arguments[0]} was never grasped and let go.")
    holds = bool(trace.of(what)[ends[-1]])
    return Verdict(holds, ends[-1], f"{what} {'held' if holds else 'did not hold'} when the hand let go.")


def _at_end(what: Atom, trace: Trace, release_steps: int) -> Verdict:
    """Decided when the hand let go of it, where it was ever held, or when it was undone after that; else since when it
    was so."""
    seen = trace.of(what)
    holds = bool(seen[-1])
    ends = releases(trace.holds[str(what.grasp)], release_steps) if str(what.grasp) in trace.holds else []
    after = np.flatnonzero(seen[ends[-1] + release_steps :]) if ends else np.empty(0, np.int64)
    if ends and not holds and len(after):
        step = ends[-1] + release_steps + int(after[-1]) + 1
    elif ends:
        step = ends[-1]
    elif holds:
        step = int(np.flatnonzero(~seen)[-1]) + 1 if not seen.all() else trace.last
    else:
        step = trace.last
    return Verdict(holds, step, f"{what} {'held' if holds else 'did not hold'} at the end.")


def _always(what: tuple[Atom, ...], trace: Trace) -> Verdict:
    first = {atom: int(np.argmin(seen)) for atom in what if not (seen := trace.of(atom)).all()}
    if first:
        atom = min(first, key=lambda a: first[a])
        return Verdict(False, first[atom], f"{atom} stopped holding.")
    said = f"{' and '.join(str(atom) for atom in what)} held throughout"
    gaps = [trace.measures[name] for atom in what if (name := f"{atom} {GAP}") in trace.measures]
    if gaps:
        nearest = np.minimum.reduce(gaps)
        step = int(np.argmin(nearest))
        return Verdict(True, step, f"{said}; the nearest came to {1000 * nearest[step]:.0f} mm.")
    own = [seen for atom in what for name, seen in trace.measures.items() if name.startswith(f"{atom} ")]
    step = int(np.argmax(np.maximum.reduce(own))) if own else trace.last
    return Verdict(True, step, f"{said}.")
