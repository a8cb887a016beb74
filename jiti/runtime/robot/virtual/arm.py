"""A virtual SO100, plugged in: what a program that drives a real one needs to drive it instead."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

from jiti.runtime.robot.virtual import registers
from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.hand import Path as HandPath
from jiti.runtime.robot.virtual.painter import CAMERAS
from jiti.runtime.robot.virtual.pictures import Pictures, by_port
from jiti.runtime.robot.virtual.process import ArmProcess
from jiti.runtime.robot.virtual.registers import Memory
from jiti.runtime.robot.virtual.world import MOUNTS, State

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig
    from lerobot.motors import MotorCalibration
    from lerobot.robots.so_follower import SO100FollowerConfig


class VirtualArm:
    """Six servos at a port, two cameras, and a task's things on the table, in real time from `with` on.

    Everything may be used from any thread.
    """

    id = "virtual"
    """By which lerobot finds its calibration."""

    def __init__(self, task: str = "so100/T5", *, seed: int = 0) -> None:
        self.task = task
        self._seed, self._faults = seed, Faults()

    def __enter__(self) -> Self:
        """Takes a second, most of it for MuJoCo. Raises UsageError for a task without a scene, or without MuJoCo."""
        self._folder = TemporaryDirectory(prefix="jiti-virtual-arm-")
        try:
            self._process = ArmProcess(self.task, self._seed, Path(self.port))
        except BaseException:
            self._folder.cleanup()
            raise
        self._pictures = by_port[self.port] = Pictures(self.task, self._process.pose)
        (self.calibration_dir / f"{self.id}.json").write_text(json.dumps(self._calibration(), indent=4))
        return self

    def __exit__(self, *_: object) -> None:
        del by_port[self.port]
        self._pictures.close()
        self._process.close()
        self._folder.cleanup()

    @property
    def port(self) -> str:
        """What lerobot opens."""
        return str(self.calibration_dir / "port")

    @property
    def calibration_dir(self) -> Path:
        """Where lerobot's calibration file of this arm is, which fits its servos, so that nothing is asked."""
        return Path(self._folder.name)

    @property
    def calibration(self) -> "dict[str, MotorCalibration]":
        """The same as lerobot has it."""
        from lerobot.motors import MotorCalibration

        return {name: MotorCalibration(**numbers) for name, numbers in self._calibration().items()}

    @property
    def faults(self) -> Faults:
        """What goes wrong; set another, and `Faults()` for nothing."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._process.set_faults(faults)
        self._faults = faults

    def cameras(self, *, width: int = 320, height: int = 240, fps: int = 30) -> "dict[str, CameraConfig]":
        """For lerobot's robots in this process: `front` and `wrist`."""
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
        return self._process.state()

    def memories(self) -> dict[int, Memory]:
        """What is in the registers of servos 1 to 6 now."""
        return self._process.memories()

    def reset(self, seed: int) -> None:
        """Put the things where a seed says, as a person would between two episodes; the arm stays as it is."""
        self._process.reset(seed)

    def lead(self, path: HandPath) -> None:
        """Have a hand move it along a path, and hold it at the end. A servo with torque resists."""
        self._process.lead(path)

    def led(self) -> bool:
        """Whether the hand has come to the end of its path."""
        return self._process.led()

    def _calibration(self) -> dict[str, dict[str, int]]:
        return {
            name: {
                "id": number,
                "drive_mode": 0,
                "homing_offset": memory[registers.OFFSET],
                "range_min": memory[registers.MIN_POSITION],
                "range_max": memory[registers.MAX_POSITION],
            }
            for name, (number, memory) in zip(MOUNTS, self.memories().items(), strict=True)
        }
