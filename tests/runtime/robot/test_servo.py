"""One servo, however its horn was screwed on: lerobot's calibration makes it step 2047 in the joint's middle."""

from math import pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.runtime.robot.virtual import registers as r
from jiti.runtime.robot.virtual.servo import STALL_NM, STEP_RAD, Servo

MOUNTS = st.integers(-2040, 2040)
SHARES = st.floats(0, 1)


def at(mount: int, share: float) -> tuple[Servo, float]:
    """A servo at a share of its joint's range, and the joint's angle."""
    angle = -0.5 + share * 2
    servo = Servo(1, low_rad=-0.5, high_rad=1.5, mount=mount)
    servo.power_up(angle)
    return servo, angle


@given(MOUNTS, SHARES)
def test_its_position_is_the_joints_angle_from_the_middle(mount, share):
    servo, angle = at(mount, share)
    assert servo.memory[r.PRESENT_POSITION] == pytest.approx(2047 + (angle - 0.5) * 4096 / (2 * pi), abs=0.51)
    low, high = servo.memory[r.MIN_POSITION], servo.memory[r.MAX_POSITION]
    assert low <= servo.memory[r.PRESENT_POSITION] <= high


@given(MOUNTS, SHARES, st.sampled_from([0, 1, 254]))
def test_its_first_goal_is_where_it_is(mount, share, acceleration):
    servo, angle = at(mount, share)
    servo.memory[r.ACCELERATION], servo.memory[r.TORQUE_ENABLE] = acceleration, 1
    for _ in range(5):
        assert servo.drive(angle, 0.005).target_rad == pytest.approx(angle, abs=STEP_RAD)


@settings(max_examples=30)
@given(MOUNTS, SHARES, SHARES, st.sampled_from([0, 20, 254]))
def test_its_target_ends_at_the_goal_without_passing_it(mount, start, end, acceleration):
    servo, angle = at(mount, start)
    there, goal = at(mount, end)
    servo.memory[r.GOAL_POSITION] = there.memory[r.PRESENT_POSITION]
    servo.memory[r.ACCELERATION], servo.memory[r.TORQUE_ENABLE] = acceleration, 1
    targets = [servo.drive(angle, 0.005).target_rad for _ in range(800)]
    assert targets[-1] == pytest.approx(goal, abs=STEP_RAD)
    assert min(angle, goal) - STEP_RAD <= min(targets)
    assert max(targets) <= max(angle, goal) + STEP_RAD


@pytest.mark.parametrize(("most", "limit", "share"), [(1000, 1000, 1.0), (500, 1000, 0.5), (1000, 300, 0.3)])
def test_its_torque_keeps_to_both_limits(most, limit, share):
    servo, angle = at(0, 0.5)
    assert servo.drive(angle, 0.005).limit_nm == 0
    servo.memory[r.MAX_TORQUE], servo.memory[r.TORQUE_LIMIT], servo.memory[r.TORQUE_ENABLE] = most, limit, 1
    assert servo.drive(angle, 0.005).limit_nm == pytest.approx(share * STALL_NM)
    servo.measure(angle, 0.0, 0.0, 0.005, weak=True)
    assert servo.drive(angle, 0.005).limit_nm == pytest.approx(min(share, 0.2) * STALL_NM)
    servo.measure(angle, 0.0, 0.0, 0.005)
    assert servo.drive(angle, 0.005).limit_nm == pytest.approx(share * STALL_NM)


def test_it_counts_turns_when_its_phase_says_so():
    servo, _ = at(0, 0.5)
    servo.memory[r.OFFSET] = -2047
    servo.write(r.PHASE.address, bytes((12 | 0x10,)))
    assert servo.memory[r.PRESENT_POSITION] == 4095
    servo.memory[r.OFFSET] = 2047
    servo.write(r.PHASE.address, bytes((12 | 0x10,)))
    assert servo.memory[r.PRESENT_POSITION] == 1
