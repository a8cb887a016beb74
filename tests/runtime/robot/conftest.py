"""A virtual arm, and lerobot's own driver connected to it."""

from collections.abc import Callable, Iterator
from time import monotonic, sleep
from typing import Any

import pytest

from jiti.runtime.robot.virtual import Faults, VirtualArm


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
