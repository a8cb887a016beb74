"""An arm's file: every mistake is told with its line, and flags count more."""

import pytest

from jiti.errors import UsageError
from jiti.runtime.robot.settings import RobotSettings, read_settings

FILE = """\
kind = "so101"
port = "/dev/ttyACM1"
max_step = 3

[cameras.front]
type = "opencv"
index_or_path = 0
width = 640
height = 480
fps = 30
"""


def test_a_file_and_flags(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(FILE)
    made = read_settings(path, port="/dev/ttyACM0", id=None)
    assert (made.kind, made.port, made.max_step, made.id) == ("so101", "/dev/ttyACM0", 3, RobotSettings().id)
    pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
    assert made.camera_configs()["front"].width == 640


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('\nprt = "x"', "line 2: there is no key 'prt'; did you mean 'port'"),
        ('fps = "fast"', "line 1: fps is 'fast'; it must be a whole number"),
        ("fps = 0", "line 1: fps is 0; it must be above 0"),
        ("max_step = -1", "line 1: max_step is -1; it must be above 0"),
        ('kind = "so10"', "line 1: kind is 'so10'; did you mean 'so10"),
        ("cameras = 3", "line 1: cameras is 3"),
        ("execute = -2", "line 1: execute is -2"),
        ("[", "is no TOML"),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path, text, message):
    path = tmp_path / "arm.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=message):
        read_settings(path)


def test_a_camera_that_lerobot_does_not_know():
    pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
    with pytest.raises(UsageError, match=r"camera 'front': .*opencvv.*type. is one of opencv"):
        RobotSettings(cameras={"front": {"type": "opencvv"}}).camera_configs()
    with pytest.raises(UsageError, match=r"camera 'front': .*index"):
        RobotSettings(cameras={"front": {"type": "opencv", "index": 0}}).camera_configs()
