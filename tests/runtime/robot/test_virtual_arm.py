"""lerobot's own `SO100Follower` drives the virtual arm, and sees its faults as on a real wire.

What the tests expect of lerobot 0.6.1 is what it does with a real arm, good or bad.
"""

import json
import shutil
import subprocess
import sys
import termios
from pathlib import Path

import psutil
import pytest

from jiti.errors import UsageError
from jiti.runtime.robot.virtual import Faults, VirtualArm
from jiti.runtime.robot.virtual import registers as r

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""

GOAL = {
    "shoulder_pan.pos": 25.0,
    "shoulder_lift.pos": -30.0,
    "elbow_flex.pos": 10.0,
    "wrist_flex.pos": 20.0,
    "wrist_roll.pos": -40.0,
    "gripper.pos": 60.0,
}


@pytest.fixture(autouse=True)
def _no_questions(monkeypatch):
    """lerobot asks on standard input when the calibration does not fit."""
    monkeypatch.setattr("builtins.input", lambda prompt="": pytest.fail(f"lerobot asks: {prompt}"))


def connected_again(arm: VirtualArm, **options):
    from lerobot.robots.so_follower import SO100Follower

    robot = SO100Follower(arm.config(**options))
    robot.connect()
    return robot


def test_its_calibration_is_the_one_in_the_file(arm, follower):
    assert follower.calibration == arm.calibration == follower.bus.read_calibration()
    assert {c.id for c in arm.calibration.values()} == set(range(1, 7))
    assert len({c.homing_offset for c in arm.calibration.values()}) == 6


def test_it_is_observed_and_goes_where_it_is_sent(arm, follower, until):
    seen = follower.get_observation()
    assert set(seen) == set(GOAL)
    assert seen["shoulder_lift.pos"] == pytest.approx(-100, abs=1)
    follower.send_action(GOAL)
    until(lambda: all(abs(v - GOAL[k]) < 3 for k, v in follower.get_observation().items()))
    # In lerobot's degrees, from the middle of each joint's range; the gripper is in percent of it.
    angles = {name: angle * 180 / 3.14159 for name, angle in arm.state().joints.items()}
    assert angles["shoulder_pan"] == pytest.approx(25, abs=3)
    assert angles["gripper"] == pytest.approx(0.6 * 100, abs=3)


def test_when_let_go_it_sinks(arm, follower, until):
    follower.send_action(GOAL)
    until(lambda: abs(follower.get_observation()["elbow_flex.pos"] - GOAL["elbow_flex.pos"]) < 3)
    before = arm.state().joints["elbow_flex"]
    follower.disconnect()
    until(lambda: arm.state().joints["elbow_flex"] > before + 0.1)


def test_what_lerobot_writes_is_in_the_servos(arm, follower):
    memories = list(arm.memories().values())
    assert {(m[r.P_COEFFICIENT], m[r.D_COEFFICIENT], m[r.TORQUE_ENABLE], m[r.LOCK]) for m in memories} == {
        (16, 32, 1, 1)
    }
    assert memories[5][r.MAX_TORQUE] == 500
    assert memories[0][r.MAX_TORQUE] == 1000


def test_all_are_found_by_a_broadcast(follower):
    assert follower.bus.broadcast_ping() == dict.fromkeys(range(1, 7), r.MODEL)


def test_a_calibration_by_hand_finds_the_middle(arm, follower):
    follower.bus.disable_torque()
    follower.bus.set_half_turn_homings()
    positions = follower.bus.sync_read("Present_Position", normalize=False)
    assert all(abs(position - 2047) < 30 for position in positions.values()), positions


def test_a_mute_servo_stops_the_loop_and_keeps_the_arm_from_connecting(arm, follower):
    arm.faults = Faults(mute=frozenset({3}))
    with pytest.raises(ConnectionError, match="There is no status packet"):
        follower.get_observation()
    with pytest.raises(ConnectionError, match="Torque_Enable"):
        follower.disconnect()
    torque = [memory[r.TORQUE_ENABLE] for memory in arm.memories().values()]
    assert torque == [0, 0, 0, 1, 1, 1], "a mute servo hears; those after it were not asked"
    follower.bus.port_handler.closePort()
    with pytest.raises(RuntimeError, match="Missing motor IDs:\n  - 3 "):
        connected_again(arm)


def test_a_corrupt_line_is_told_and_forgotten(arm, follower):
    arm.faults = Faults(corrupt=1.0)
    with pytest.raises(ConnectionError, match="status packet"):
        follower.get_observation()
    arm.faults = Faults()
    follower.bus.port_handler.ser.reset_input_buffer()
    assert set(follower.get_observation()) == set(GOAL)


def test_a_slow_servo_is_not_waited_for(arm, follower):
    arm.faults = Faults(slow_s=0.5)
    with pytest.raises(ConnectionError, match="There is no status packet"):
        follower.bus.read("Present_Load", "elbow_flex")


def test_an_overload_shows_where_one_servo_is_asked_and_not_where_all_are(arm, follower, until):
    arm.faults = Faults(overload=frozenset({6}))
    until(lambda: arm.memories()[6][r.STATUS] != 0)
    with pytest.raises(RuntimeError, match="Overload error"):
        follower.bus.read("Present_Load", "gripper")
    follower.bus.read("Present_Load", "elbow_flex")
    assert set(follower.get_observation()) == set(GOAL)
    with pytest.raises(RuntimeError, match="Overload error"):
        follower.disconnect()


def test_an_unplugged_arm_keeps_its_torque_and_can_be_plugged_in_again(arm, follower, until):
    arm.faults = Faults(unplugged=True)
    until(lambda: not Path(arm.port).exists())
    with pytest.raises(termios.error, match="Input/output error"):
        follower.get_observation()
    assert follower.is_connected, "lerobot does not notice"
    with pytest.raises(ConnectionError, match="Could not connect"):
        connected_again(arm)
    assert all(memory[r.TORQUE_ENABLE] for memory in arm.memories().values())
    follower.bus.port_handler.closePort()
    arm.faults = Faults()
    until(lambda: Path(arm.port).exists())
    robot = connected_again(arm)
    assert set(robot.get_observation()) == set(GOAL)
    robot.disconnect()


def test_nothing_is_left_behind():
    with VirtualArm() as arm:
        folder = arm.calibration_dir
        assert json.loads((folder / "virtual.json").read_text())["gripper"]["id"] == 6
        target = Path(arm.port).readlink()
        assert target.exists()
    assert not folder.exists()


def test_a_task_without_a_scene_is_told_at_once():
    with pytest.raises(UsageError, match="did you mean 'so100/T5'"), VirtualArm("so100/T55"):
        pass


def test_a_process_that_was_ended_is_told(arm):
    arm._process._child.kill()
    with pytest.raises(RuntimeError, match="has ended with -9"):
        arm.state()


def test_it_ends_with_the_program_that_opened_it(until):
    code = (
        "import os\nfrom jiti.runtime.robot.virtual import VirtualArm\n"
        "arm = VirtualArm().__enter__()\nprint(arm._process._child.pid, arm.calibration_dir, flush=True)\nos._exit(1)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    process, folder = done.stdout.split()
    until(lambda: not psutil.pid_exists(int(process)) or psutil.Process(int(process)).status() == psutil.STATUS_ZOMBIE)
    assert not (Path(folder) / "port").exists()
    shutil.rmtree(folder)


def test_it_is_imported_without_anything_heavy():
    code = (
        "import sys, jiti.runtime.robot.virtual\n"
        "print(sorted({'torch', 'lerobot', 'mujoco', 'cv2'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
