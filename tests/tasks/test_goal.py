"""Goals in BDDL: what they parse to, what they need to be watched, and what is said of one that is wrong."""

import pytest

from jiti.errors import CatalogueError
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.goal import Always, And, AtEnd, Atom, AtRelease, Until, atoms, parse_goal

HELD, RESTS = Atom("IsGrasping", ("bowl_1",)), Atom("IsOnBottomOf", ("bowl_1", "plate_1"))


def test_each_word_is_read():
    text = """
    (And (Until (IsGrasping bowl_1) (IsOnBottomOf bowl_1 plate_1))
         (AtEnd (IsPreciselyOn bowl_1 plate_1 0.02))
         (AtRelease (IsOnBottomOf bowl_1 plate_1))
         (Always (PositionUnchanged cup_1) (PositionUnchanged cup_2)))
    """
    assert parse_goal(text) == And(
        (
            Until(HELD, RESTS),
            AtEnd(Atom("IsPreciselyOn", ("bowl_1", "plate_1"), 0.02)),
            AtRelease(RESTS),
            Always((Atom("PositionUnchanged", ("cup_1",)), Atom("PositionUnchanged", ("cup_2",)))),
        )
    )


def test_a_bare_predicate_speaks_of_the_end_as_in_liberos_goals():
    assert parse_goal("(On bowl_1 plate_1)") == AtEnd(Atom("On", ("bowl_1", "plate_1")))


def test_what_is_watched_is_named_once_and_a_release_needs_the_grasp():
    goal = parse_goal("(And (AtRelease (IsOnBottomOf bowl_1 plate_1)) (AtEnd (IsOnBottomOf bowl_1 plate_1)))")
    assert atoms(goal) == (RESTS, HELD)


def test_an_atom_reads_back_as_it_is_written():
    for text in ("IsGrasping bowl_1", "IsPreciselyOn bowl_1 plate_1 0.02"):
        goal = parse_goal(f"({text})")
        assert isinstance(goal, AtEnd)
        assert str(goal.what) == text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"starts with '\('"),
        ("IsGrasping bowl_1", r"starts with '\('"),
        ("(IsGrasping bowl_1", r"a '\)' is missing"),
        ("(IsGrasping bowl_1) (In a b)", "after the goal there is"),
        ("(IsGrasping bowl_1))", "after the goal there is"),
        ("(IsGrasping)", r"\(IsGrasping\) is no predicate of named things"),
        ("(Until (IsGrasping bowl_1))", "holds 1 things; it takes 2"),
        ("(Always)", "is empty"),
        ("(And bowl_1)", "put it in brackets"),
        ("(AtEnd (And (On a b)))", "is no predicate of named things"),
        ("(IsPreciselyOn bowl_1 plate_1 -1)", "tolerance that is not over 0"),
        ("(IsPreciselyOn 0.1)", "no thing that it speaks of"),
        ("(IsPreciselyOn bowl_1 nan)", "tolerance that is not over 0"),
    ],
)
def test_a_wrong_goal_is_answered_with_what_is_wrong(text, said):
    with pytest.raises(CatalogueError, match=said):
        parse_goal(text)


def test_every_simulated_itc_of_the_package_has_a_goal_on_its_own_things():
    simulated = [task for task in load_catalogue() if task.bddl]
    assert len(simulated) == 21
    for task in simulated:
        for itc in task.itcs:
            assert atoms(parse_goal(itc.goal)), itc.itc_id


def test_a_goal_of_a_users_file_is_checked_with_its_line(tmp_path):
    file = tmp_path / "tasks.toml"
    file.write_text(
        '[[task]]\nid = "lab/a"\ninstruction = "a"\n\n[[task.itc]]\nid = "b"\ncriterion = "pose_alignment"\n'
        'statement = "s"\ngoal = "(Until (IsGrasping a))"\n'
    )
    with pytest.raises(CatalogueError, match=r"tasks\.toml, line 9: the goal cannot be read: .*holds 1 things"):
        load_catalogue(file)
