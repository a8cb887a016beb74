"""lerobot's real driver of a leader on a virtual arm: it is read, never asked about, and never has torque."""

import json
from dataclasses import replace
from time import sleep

import numpy as np
import pytest

from jiti.errors import RobotError
from jiti.runtime.robot.leader import Leader
from jiti.runtime.robot.virtual import Faults, registers
from jiti.runtime.robot.virtual.demonstrator import now
from jiti.runtime.robot.virtual.hand import smooth

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""


@pytest.fixture(autouse=True)
def _no_questions(monkeypatch):
    monkeypatch.setattr("builtins.input", lambda prompt="": pytest.fail(f"someone asks: {prompt}"))


def read_until_it_raises(leader) -> None:
    for _ in range(100):
        leader.read()
        sleep(1 / 30)


def test_it_is_read_where_a_hand_has_it(leader_arm, led_settings, until):
    with Leader(led_settings) as leader:
        assert leader.read()["shoulder_lift"] == pytest.approx(-100, abs=1)
        place = np.array([0.4, -0.5, 0.9, -0.3, 0.8, 0.5])
        leader_arm.lead(smooth([now(leader_arm.state()), place], 0.5))
        until(leader_arm.led)
        until(lambda: abs(leader.read()["shoulder_pan"] - np.degrees(0.4)) < 2)
        assert leader.read()["gripper"] == pytest.approx(100 * 0.5 / 1.745, abs=3)
        assert all(memory[registers.TORQUE_ENABLE] == 0 for memory in leader_arm.memories().values())


def test_torque_that_was_left_on_is_taken(leader_arm, led_settings):
    from lerobot.robots.so_follower import SO100Follower

    robot = SO100Follower(leader_arm.config())
    robot.connect()
    robot.bus.port_handler.closePort()
    assert all(memory[registers.TORQUE_ENABLE] for memory in leader_arm.memories().values())
    with Leader(led_settings):
        assert not any(memory[registers.TORQUE_ENABLE] for memory in leader_arm.memories().values())


def test_a_calibration_that_is_missing_or_another_arms_is_told(leader_arm, led_settings, tmp_path):
    with (
        pytest.raises(RobotError, match=r"the leader 'mine' has no calibration .* --teleop\.type=so100_leader .*=mine"),
        Leader(replace(led_settings, leader_id="mine")),
    ):
        pass
    path = leader_arm.calibration_dir / "virtual.json"
    changed = json.loads(path.read_text())
    changed["elbow_flex"]["homing_offset"] += 7
    path.write_text(json.dumps(changed))
    with pytest.raises(RobotError, match=r"elbow_flex has homing_offset .* own --leader-id"), Leader(led_settings):
        pass


def test_a_port_that_is_not_there_is_the_leaders(led_settings):
    with (
        pytest.raises(RobotError, match="the leader: there is no /dev/ttyNONE"),
        Leader(replace(led_settings, leader="/dev/ttyNONE")),
    ):
        pass


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        (Faults(mute=frozenset({3})), r"servo 3 \(elbow_flex\) of the leader does not answer\. Check the cable"),
        (Faults(unplugged=True), "is gone in the middle of work: plug the leader's USB cable in again"),
    ],
)
def test_one_that_goes_mute_is_named(leader_arm, led_settings, faults, message):
    with Leader(led_settings) as leader:
        assert leader.read()
        leader_arm.faults = faults
        with pytest.raises(RobotError, match=message):
            read_until_it_raises(leader)
