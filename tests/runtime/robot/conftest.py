"""A virtual arm, and lerobot's own driver connected to it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import monotonic, sleep
from typing import Any

import pytest

from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.virtual import Faults, VirtualArm, registers
from jiti.runtime.robot.virtual.scenes import EMPTY


@pytest.fixture
def arm() -> Iterator[VirtualArm]:
    pytest.importorskip("mujoco", reason="pip install 'jiti[robot]'")
    with VirtualArm("so100/T2", seed=0) as arm:
        yield arm


@pytest.fixture
def follower(arm: VirtualArm) -> Iterator[Any]:
    """lerobot's `SO100Follower`, connected; whatever became of it, its port is closed in the end."""
    pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
    from lerobot.robots.so_follower import SO100Follower

    robot = SO100Follower(arm.config())
    robot.connect()
    yield robot
    arm.faults = Faults()
    robot.bus.port_handler.closePort()


@pytest.fixture
def until() -> Callable[[Callable[[], bool]], None]:
    """Waits for something to come true, however slow the machine is."""

    def wait(true: Callable[[], bool]) -> None:
        end = monotonic() + 60
        while not true():
            assert monotonic() < end, "it never came true"
            sleep(0.02)

    return wait


@pytest.fixture
def settings(arm: VirtualArm) -> RobotSettings:
    """Of the virtual arm, with less patience than people have, and more for a machine with much else to do."""
    return RobotSettings(
        port=arm.port,
        id=arm.id,
        calibration_dir=str(arm.calibration_dir),
        lost_s=1.0,
        release_after_s=0.3,
        replug_s=3.0,
        stall_s=2.0,
    )


@pytest.fixture
def torque(arm: VirtualArm) -> Callable[[], list[int]]:
    """Of each servo, 1 or 0."""
    return lambda: [memory[registers.TORQUE_ENABLE] for memory in arm.memories().values()]


@pytest.fixture
def leader_arm() -> Iterator[VirtualArm]:
    """An arm that leads another: nothing is in its reach."""
    pytest.importorskip("mujoco", reason="pip install 'jiti[robot]'")
    with VirtualArm(EMPTY) as arm:
        yield arm


@pytest.fixture
def led_settings(settings: RobotSettings, leader_arm: VirtualArm) -> RobotSettings:
    """With a leader."""
    folder = str(leader_arm.calibration_dir)
    return replace(settings, leader=leader_arm.port, leader_id=leader_arm.id, leader_calibration_dir=folder)
