"""A virtual SO100, plugged in: what a program that drives a real one needs to drive it instead."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

from jiti.runtime.robot.virtual import registers
from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.line import Line
from jiti.runtime.robot.virtual.pictures import CAMERAS, Pictures, by_port
from jiti.runtime.robot.virtual.world import MOUNTS, State, World

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig
    from lerobot.motors import MotorCalibration
    from lerobot.robots.so_follower import SO100FollowerConfig


class VirtualArm:
    """Six servos at a port, two cameras, and a task's things on the table, in real time while it is open.

    Everything may be used from any thread.
    """

    id = "virtual"
    """By which lerobot finds its calibration."""

    def __init__(self, task: str = "so100/T5", *, seed: int = 0) -> None:
        """Raises UsageError for a task without a scene."""
        self.faults = Faults()
        self.world = World(task, seed=seed, faults=self.faults)
        self._folder: TemporaryDirectory[str] | None = None

    def __enter__(self) -> Self:
        self._folder = TemporaryDirectory(prefix="jiti-virtual-arm-")
        calibration = json.dumps(self._calibration(), indent=4)
        (self.calibration_dir / f"{self.id}.json").write_text(calibration)
        self._line, self._pictures = Line(self.world, Path(self.port)), Pictures(self.world)
        self._line.start()
        by_port[self.port] = self._pictures
        return self

    def __exit__(self, *_: object) -> None:
        del by_port[self.port]
        self._pictures.close()
        self._line.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    @property
    def port(self) -> str:
        """What lerobot opens."""
        return str(self.calibration_dir / "port")

    @property
    def calibration_dir(self) -> Path:
        """Where lerobot's calibration file of this arm is, which fits its servos, so that nothing is asked."""
        if self._folder is None:
            raise RuntimeError("the virtual arm is not open: `with VirtualArm(...) as arm:`")
        return Path(self._folder.name)

    @property
    def calibration(self) -> "dict[str, MotorCalibration]":
        """The same as lerobot has it."""
        from lerobot.motors import MotorCalibration

        return {name: MotorCalibration(**numbers) for name, numbers in self._calibration().items()}

    def cameras(self, *, width: int = 320, height: int = 240, fps: int = 30) -> "dict[str, CameraConfig]":
        """For lerobot's robots: `front` and `wrist`."""
        from jiti.runtime.robot.virtual.config_camera import VirtualCameraConfig

        return {
            name: VirtualCameraConfig(port=self.port, camera=name, width=width, height=height, fps=fps)
            for name in CAMERAS
        }

    def config(self, **options: Any) -> "SO100FollowerConfig":
        """The configuration with which lerobot's `SO100Follower` drives it; `options` are further fields of it."""
        from lerobot.robots.so_follower import SO100FollowerConfig

        return SO100FollowerConfig(port=self.port, id=self.id, calibration_dir=self.calibration_dir, **options)

    def state(self) -> State:
        """Where everything is now."""
        return self.world.state()

    def reset(self, seed: int) -> None:
        """Put the things where a seed says, as a person would between two episodes; the arm stays as it is."""
        self.world.reset(seed)

    def _calibration(self) -> dict[str, dict[str, int]]:
        return {
            name: {
                "id": number,
                "drive_mode": 0,
                "homing_offset": servo.memory[registers.OFFSET],
                "range_min": servo.memory[registers.MIN_POSITION],
                "range_max": servo.memory[registers.MAX_POSITION],
            }
            for name, (number, servo) in zip(MOUNTS, self.world.servos.items(), strict=True)
        }
