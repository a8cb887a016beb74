"""Verdicts on traces that are written out by hand, with the step at which each was decided."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.errors import CatalogueError
from jiti.tasks.goal import Atom, parse_goal
from jiti.tasks.judge import RELEASE_STEPS, Trace, judge, releases

HELD, RESTS, STILL = "IsGrasping a", "IsOnBottomOf a b", "PositionUnchanged c"
UNTIL = parse_goal("(Until (IsGrasping a) (IsOnBottomOf a b))")


def trace(measures: dict[str, list[float]] | None = None, **holds: str) -> Trace:
    """Each predicate as a row of 0 and 1."""
    names = {"held": HELD, "rests": RESTS, "still": STILL}
    rows = {names[key]: np.array([c == "1" for c in row]) for key, row in holds.items()}
    return Trace(rows, {key: np.array(values) for key, values in (measures or {}).items()})


@pytest.mark.parametrize(
    ("held", "rests", "satisfied", "step"),
    [
        ("0011110000", "0000110000", True, 5),  # let go while it rests
        ("0011110000", "0000011111", True, 5),
        ("0011110000", "0000001111", False, 5),  # let go a step before
        ("0000000000", "1111111111", False, 9),  # never grasped
        ("0011111111", "0000111111", False, 9),  # never let go
        ("0011011000", "0000001111", True, 6),  # a flicker is no release
        ("0110000110", "0000000011", False, 2),  # slipped, and was picked up again
    ],
)
def test_held_until_it_rests(held, rests, satisfied, step):
    verdict = judge(UNTIL, trace(held=held, rests=rests))
    assert (verdict.satisfied, verdict.step) == (satisfied, step)


@pytest.mark.parametrize(
    ("held", "rests", "satisfied", "step"),
    [
        ("0111100000", "0000100000", True, 4),
        ("0111100000", "0000011111", False, 4),
        ("011000011000", "001000001000", True, 8),  # the last time counts
        ("011000011000", "001000000000", False, 8),
        ("0000000000", "1111111111", False, 9),
    ],
)
def test_at_release_looks_at_the_last_step_of_contact(held, rests, satisfied, step):
    verdict = judge(parse_goal("(AtRelease (IsOnBottomOf a b))"), trace(held=held, rests=rests))
    assert (verdict.satisfied, verdict.step) == (satisfied, step)


@pytest.mark.parametrize(
    ("rows", "satisfied", "step"),
    [
        ({"held": "0111100000", "rests": "0000001111"}, True, 4),  # decided when it was let go
        ({"held": "0111100000", "rests": "0000100000"}, False, 4),
        ({"held": "0111100000", "rests": "0000001110"}, False, 9),  # knocked off again
        ({"rests": "0000001111"}, True, 6),  # without a grasp: since when it was so
        ({"rests": "0110001011"}, True, 8),
        ({"rests": "1111111111"}, True, 9),
        ({"rests": "0000001110"}, False, 9),
    ],
)
def test_at_end_looks_at_the_last_step(rows, satisfied, step):
    verdict = judge(parse_goal("(AtEnd (IsOnBottomOf a b))"), trace(**rows))
    assert (verdict.satisfied, verdict.step) == (satisfied, step)


def test_always_is_broken_at_the_first_step_and_else_decided_where_it_was_nearest():
    goal = parse_goal("(Always (PositionUnchanged c))")
    gaps = {f"{STILL} gap_m": [0.2, 0.1, 0.03, 0.03, 0.2, 0.2]}
    assert judge(goal, trace(still="110111")).step == 2
    assert not judge(goal, trace(still="110111")).satisfied
    verdict = judge(goal, trace(gaps, still="111111"))
    assert (verdict.satisfied, verdict.step) == (True, 2)
    assert "30 mm" in verdict.reason
    assert judge(goal, trace(still="111111")).step == 5


def test_what_must_be_gentle_is_decided_where_it_was_least_so():
    goal = parse_goal("(And (AtEnd (Close d)) (Always (MovesGently d)))")
    rows = {"Close d": np.array([False] * 5 + [True] * 5), "MovesGently d": np.ones(10, bool)}
    speed = {"MovesGently d speed": np.array([0, 0.01, 0.05, 0.09, 0.04, 0, 0, 0, 0, 0])}
    verdict = judge(goal, Trace(rows, speed))
    assert (verdict.satisfied, verdict.step) == (True, 5)  # shut, after the fastest moment


def test_all_parts_count_and_the_first_violation_is_the_one_that_is_told():
    goal = parse_goal("(And (Always (PositionUnchanged c)) (Until (IsGrasping a) (IsOnBottomOf a b)))")
    good = {"held": "0011100000", "rests": "0000111111"}
    assert judge(goal, trace(still="1111111111", **good)).satisfied
    broken = judge(goal, trace(still="1110111111", **good))
    assert (broken.satisfied, broken.step) == (False, 3)
    early = judge(goal, trace(still="1111111101", held="0011000000", rests="0000111111"))
    assert (early.satisfied, early.step) == (False, 3)


def test_a_trace_of_other_goals_is_refused():
    with pytest.raises(CatalogueError, match=r"no 'IsOnBottomOf a b', it has: IsGrasping a"):
        judge(UNTIL, trace(held="0110000"))


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_a_release_is_the_end_of_contact_and_never_within_a_flicker(contact):
    text = "".join("1" if c else "0" for c in contact)
    ends = releases(np.array(contact))
    assert ends == [m.start() for m in re.finditer(f"1(?={'0' * RELEASE_STEPS})", text)]


def test_an_atom_knows_the_grasp_of_what_it_speaks_of():
    assert Atom("IsOnBottomOf", ("a", "b")).grasp == Atom("IsGrasping", ("a",))
