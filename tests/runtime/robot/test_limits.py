"""What may be sent: every joint, finite, in its range, a step from the goal before."""

import math

import pytest

from jiti.errors import RobotError
from jiti.runtime.robot.limits import Limits

LIMITS = Limits({"pan": -90.0, "gripper": 0.0}, {"pan": 90.0, "gripper": 100.0}, max_step=5.0)
BEFORE = {"pan": 0.0, "gripper": 50.0}


def test_what_is_near_and_inside_is_sent_as_it_is():
    checked = LIMITS.check({"pan": 4.0, "gripper": 46.0}, BEFORE)
    assert (checked.goal, checked.clamped) == ({"pan": 4.0, "gripper": 46.0}, ())


@pytest.mark.parametrize(("asked", "before", "goal"), [(720, 0, 5), (-720, 0, -5), (720, 89, 90), (80, 90, 85)])
def test_nothing_passes_the_range_or_a_step(asked, before, goal):
    checked = LIMITS.check({"pan": asked, "gripper": 50.0}, {"pan": before, "gripper": 50.0})
    assert checked.goal["pan"] == goal
    assert checked.clamped == ("pan",)


def test_steps_lead_to_the_end_of_the_range_and_stay_there():
    goal = BEFORE
    for _ in range(40):
        goal = LIMITS.check({"pan": 1e9, "gripper": -1e9}, goal).goal
    assert goal == {"pan": 90.0, "gripper": 0.0}


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_by_name(number):
    with pytest.raises(RobotError, match="for gripper, which is no place"):
        LIMITS.check({"pan": 0.0, "gripper": number}, BEFORE)


def test_a_missing_or_unknown_joint_is_refused_by_name():
    with pytest.raises(RobotError, match="lacks gripper"):
        LIMITS.check({"pan": 0.0}, BEFORE)
    with pytest.raises(RobotError, match="has elbow, which this arm has not"):
        LIMITS.check({"pan": 0.0, "gripper": 0.0, "elbow": 0.0}, BEFORE)
    with pytest.raises(RobotError, match="lacks pan, gripper"):
        LIMITS.check({}, BEFORE)
