"""The arm moves as its servos would move it, and one seed is one scene."""

from math import pi

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.robot.virtual import registers as r
from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.scenes import OPEN_M, SCENES
from jiti.runtime.robot.virtual.servo import FASTEST, STEP_RAD
from jiti.runtime.robot.virtual.world import CONTROL_S, MOUNTS, World
from jiti.tasks.catalogue import load_catalogue

pytest.importorskip("mujoco", reason="pip install 'jiti[robot]'")

IDS = dict(zip(MOUNTS, range(1, 7), strict=True))
SECOND = round(1 / CONTROL_S)
RAISED = {"shoulder_lift": -20, "elbow_flex": -10, "wrist_flex": 20, "gripper": 0}
"""Degrees from the middle of each joint: out in the air, clear of everything."""


def enable(world: World) -> None:
    """As lerobot's `configure` leaves the servos."""
    for servo in world.servos.values():
        servo.memory[r.P_COEFFICIENT], servo.memory[r.ACCELERATION] = 16, 254
        servo.memory[r.TORQUE_ENABLE] = 1
    gripper = world.servos[IDS["gripper"]].memory
    gripper[r.MAX_TORQUE], gripper[r.OVERLOAD_TORQUE] = 500, 25


def go(world: World, degrees: dict[str, float], seconds: float = 2) -> None:
    """To angles from the middle of each joint, as lerobot counts degrees."""
    for name, angle in degrees.items():
        world.servos[IDS[name]].memory[r.GOAL_POSITION] = 2047 + round(angle / 360 * r.STEPS)
    world.step(round(seconds * SECOND))


def present(world: World, name: str) -> float:
    return (world.servos[IDS[name]].memory[r.PRESENT_POSITION] - 2047) * 360 / r.STEPS


@pytest.fixture
def raised() -> World:
    world = World("so100/T2", faults=Faults())
    enable(world)
    go(world, RAISED)
    return world


def test_every_task_of_the_suite_has_a_scene():
    assert set(SCENES) == {task.task_id for task in load_catalogue() if task.task_id.startswith("so100/")}
    with pytest.raises(UsageError, match="did you mean 'so100/T5'"):
        World("so100/T55")


@pytest.mark.parametrize("task_id", SCENES)
def test_a_seed_is_a_scene_in_which_everything_rests(task_id):
    one, same, other = World(task_id, seed=3), World(task_id, seed=3), World(task_id, seed=4)
    first, again, different = one.state(), same.state(), other.state()
    for name in SCENES[task_id]:
        np.testing.assert_array_equal(first.objects[name], again.objects[name])
        assert not np.allclose(first.objects[name], different.objects[name])
    one.step(SECOND)
    same.step(SECOND)
    np.testing.assert_array_equal(one.data.qpos, same.data.qpos)
    for name, pose in one.state().objects.items():
        np.testing.assert_allclose(pose[:3, 3], first.objects[name][:3, 3], atol=0.004)


def test_laid_out_anew_it_is_the_seeds_scene_and_the_arm_stays(raised):
    angles = raised.state().joints
    raised.reset(5)
    assert raised.state().joints == angles
    for name, pose in World("so100/T2", seed=5).state().objects.items():
        np.testing.assert_allclose(raised.state().objects[name], pose, atol=1e-12)


@pytest.mark.parametrize("name", MOUNTS)
def test_each_joint_goes_where_it_is_told(raised, name):
    """To the error that a spring has under the arm's weight."""
    for angle in (25, -5):
        go(raised, {name: angle})
        assert present(raised, name) == pytest.approx(angle, abs=2.5)
        middle = np.mean(raised.model.joint(name).range)
        assert raised.state().joints[name] == pytest.approx(middle + present(raised, name) * pi / 180, abs=STEP_RAD)


def test_no_joint_overshoots_or_is_faster_than_the_motor(raised):
    servo = raised.servos[IDS["shoulder_pan"]]
    go(raised, {"shoulder_pan": 80}, seconds=0)
    positions, speeds = [], []
    for _ in range(2 * SECOND):
        raised.step()
        positions.append(present(raised, "shoulder_pan"))
        speeds.append(servo.memory[r.PRESENT_VELOCITY])
    assert max(positions) < 80.5
    assert 0.5 * FASTEST < max(speeds) <= FASTEST


def test_a_goal_velocity_is_kept_to(raised):
    servo = raised.servos[IDS["shoulder_pan"]]
    servo.memory[r.GOAL_VELOCITY] = 400
    go(raised, {"shoulder_pan": 80}, seconds=1)
    assert servo.memory[r.PRESENT_VELOCITY] == pytest.approx(400, abs=20)
    assert servo.memory[r.MOVING] == 1


def test_a_goal_beyond_the_limits_is_not_gone_to(raised):
    go(raised, {"shoulder_pan": 720}, seconds=3)
    assert raised.state().joints["shoulder_pan"] == pytest.approx(1.92, abs=0.01)


def test_without_torque_it_sinks_and_a_goal_from_before_swings_it_back(raised):
    held = present(raised, "elbow_flex")
    raised.step(SECOND)
    assert present(raised, "elbow_flex") == pytest.approx(held, abs=0.2)
    for servo in raised.servos.values():
        servo.memory[r.TORQUE_ENABLE] = 0
    raised.step(2 * SECOND)
    assert present(raised, "elbow_flex") > held + 10
    assert all(servo.memory[r.PRESENT_LOAD] == 0 for servo in raised.servos.values())
    enable(raised)
    raised.step(2 * SECOND)
    assert present(raised, "elbow_flex") == pytest.approx(held, abs=0.5)


def test_a_jammed_joint_stays_and_after_two_seconds_its_servo_is_overloaded(raised):
    servo = raised.servos[IDS["elbow_flex"]]
    before = present(raised, "elbow_flex")
    raised.faults = Faults(jam=frozenset({IDS["elbow_flex"]}))
    go(raised, {"elbow_flex": 60}, seconds=1.5)
    assert present(raised, "elbow_flex") == pytest.approx(before, abs=0.5)
    assert (servo.memory[r.PRESENT_LOAD], servo.error) == (1000, 0)
    raised.step(SECOND)
    assert (servo.memory[r.PRESENT_LOAD], servo.error) == (200, r.Error.OVERLOAD)
    servo.memory[r.TORQUE_ENABLE] = 0
    raised.step()
    assert servo.error == 0
    raised.faults = Faults()
    servo.memory[r.TORQUE_ENABLE] = 1
    go(raised, {"elbow_flex": 60})
    assert present(raised, "elbow_flex") == pytest.approx(60, abs=2.5)


def test_the_gripper_holds_a_block_even_when_it_is_overloaded_by_it(raised):
    """The angles reach for where the red block lies with seed 0; the jaws close along its faces."""
    above = {"shoulder_pan": -15, "shoulder_lift": 18, "elbow_flex": -31, "wrist_flex": 93, "wrist_roll": 0}
    down = above | {"shoulder_lift": 19.5, "elbow_flex": 1.5, "wrist_flex": 59.3}
    open_, shut = {"gripper": 0}, {"gripper": -50}
    before = raised.state().objects["red_block"][2, 3]
    for pose in (above | open_, down | open_, down | shut, above | shut):
        go(raised, pose)
    raised.step(3 * SECOND)
    assert raised.servos[IDS["gripper"]].error == r.Error.OVERLOAD
    assert raised.state().objects["red_block"][2, 3] > before + 0.03


def test_the_drawer_is_shut_by_a_push():
    world = World("so100/T5", seed=0)
    enable(world)
    opened = world.state().drawers["top_drawer"]
    assert OPEN_M[0] <= opened <= OPEN_M[1]
    go(world, {"wrist_flex": -57})
    go(world, {"shoulder_lift": -38, "elbow_flex": 94, "wrist_flex": -57, "gripper": -50})
    go(world, {"shoulder_pan": 40.5})
    go(world, {"shoulder_lift": -1, "elbow_flex": 68, "wrist_flex": -67})
    assert world.state().drawers["top_drawer"] == opened
    world.servos[IDS["shoulder_lift"]].memory[r.GOAL_VELOCITY] = 200
    world.servos[IDS["elbow_flex"]].memory[r.GOAL_VELOCITY] = 300
    world.servos[IDS["wrist_flex"]].memory[r.GOAL_VELOCITY] = 120
    go(world, {"shoulder_lift": 24.5, "elbow_flex": 29, "wrist_flex": -51}, seconds=4)
    assert world.state().drawers["top_drawer"] < 0.002


def test_a_clock_moves_it_but_not_to_make_up_for_a_pause():
    world = World("so100/T2")
    for now_s in (100.0, 100.004, 100.012, 1100.0, 1100.021):
        world.advance(now_s)
    assert world.data.time == pytest.approx(0.01 + 0.02)
