"""The virtual arm's cameras, in lerobot's robot and alone."""

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.robot.virtual import VirtualArm

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.sim,
    pytest.mark.filterwarnings("ignore"),
    pytest.mark.usefixtures("graphics"),
]
"""lerobot and what it imports warn of themselves."""

SIZE = {"width": 160, "height": 120, "fps": 5}


def of_colour(picture: np.ndarray, *, more: int, than: int) -> int:
    """Pixels in which one channel is far brighter than another."""
    return int((picture[..., more].astype(int) - picture[..., than] > 60).sum())


@pytest.fixture
def camera(arm):
    """Makes one of the arm's cameras, connected."""
    from jiti.runtime.robot.virtual.camera import VirtualCamera
    from jiti.runtime.robot.virtual.config_camera import VirtualCameraConfig

    made = []

    def make(name: str, **options):
        one = VirtualCamera(VirtualCameraConfig(port=arm.port, camera=name, **SIZE | options))
        made.append(one)
        one.connect()
        return one

    yield make
    for one in made:
        one.disconnect()


def test_lerobots_robot_has_them_in_its_observation(arm):
    from lerobot.robots.so_follower import SO100Follower

    robot = SO100Follower(arm.config(cameras=arm.cameras(**SIZE)))
    assert robot.observation_features["front"] == (120, 160, 3)
    robot.connect()
    try:
        seen = robot.get_observation()
        for name in ("front", "wrist"):
            assert (seen[name].shape, seen[name].dtype) == ((120, 160, 3), np.uint8)
            assert seen[name].std() > 10
        assert np.abs(seen["front"].astype(int) - seen["wrist"]).mean() > 20
        assert of_colour(seen["front"], more=0, than=1) > 20, "the red block"
        assert of_colour(seen["front"], more=0, than=2) > 300, "the yellow arm"
    finally:
        robot.disconnect()


def test_they_see_what_moves(arm, camera):
    front = camera("front")
    before = front.read()
    arm.reset(seed=7)
    assert np.abs(front.read().astype(int) - before).max() > 60


def test_a_picture_is_given_out_once_unless_the_last_is_asked_for(camera):
    front = camera("front", fps=2)
    first = front.read()
    assert front.read_latest() is not None
    second = front.async_read(timeout_ms=30_000)
    assert second is not first
    with pytest.raises(TimeoutError, match="more than 0 ms"):
        front.read_latest(max_age_ms=0)
    wrist = camera("wrist", fps=0.01)
    wrist.async_read()
    with pytest.raises(TimeoutError, match="no picture"):
        wrist.async_read(timeout_ms=1)


def test_there_are_two_and_only_while_the_arm_is_open(camera):
    from jiti.runtime.robot.virtual.camera import VirtualCamera
    from jiti.runtime.robot.virtual.config_camera import VirtualCameraConfig

    assert {found["camera"] for found in VirtualCamera.find_cameras()} == {"front", "wrist"}
    with pytest.raises(UsageError, match="it has: front, wrist"):
        camera("top")
    with pytest.raises(UsageError, match="open VirtualArm first"):
        VirtualCamera(VirtualCameraConfig(port="/dev/nothing")).connect()


def test_an_arm_that_is_closed_before_its_cameras_leaves_nothing_running():
    from lerobot.cameras import make_cameras_from_configs

    with VirtualArm("so100/T5") as arm:
        cameras = make_cameras_from_configs(arm.cameras(**SIZE))
        for one in cameras.values():
            one.connect()
    for one in cameras.values():
        one.disconnect()
        assert not one.is_connected
