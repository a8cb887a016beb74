"""A virtual arm's camera, as lerobot's robots take it."""

from time import perf_counter
from typing import Any

import numpy as np
from lerobot.cameras import Camera  # noqa: TID253 - this module is lerobot's plugin
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected  # noqa: TID253

from jiti.errors import UsageError
from jiti.runtime.robot.virtual.config_camera import VirtualCameraConfig
from jiti.runtime.robot.virtual.painter import CAMERAS
from jiti.runtime.robot.virtual.pictures import FIRST_S, Pictures, by_port


class VirtualCamera(Camera):
    """Pictures are (height, width, 3) uint8, RGB."""

    def __init__(self, config: VirtualCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._pictures: Pictures | None = None
        self._seen_s = 0.0

    def __str__(self) -> str:
        return f"VirtualCamera({self.config.camera} at {self.config.port})"

    @property
    def is_connected(self) -> bool:
        return self._pictures is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        return [{"type": "virtual", "port": port, "camera": camera} for port in by_port for camera in CAMERAS]

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Raises UsageError where the arm is not open in this process, or nothing renders."""
        pictures = by_port.get(self.config.port)
        if pictures is None:
            raise UsageError(f"no virtual arm is open at {self.config.port} in this process: open VirtualArm first")
        config = self.config
        pictures.start(config.camera, width=config.width, height=config.height, fps=config.fps)
        try:
            if warmup:
                pictures.after(config.camera, 0.0, FIRST_S)
        except BaseException:
            pictures.stop(config.camera)
            raise
        self._pictures = pictures

    def disconnect(self) -> None:
        if self._pictures is not None:
            self._pictures.stop(self.config.camera)
            self._pictures = None

    @check_if_not_connected
    def read(self) -> np.ndarray:
        """A picture of what is seen from now on."""
        return self._after(perf_counter(), FIRST_S)

    @check_if_not_connected
    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """A picture that was not yet given out here. Raises TimeoutError."""
        return self._after(self._seen_s, timeout_ms / 1000)

    @check_if_not_connected
    def read_latest(self, max_age_ms: int = 1000) -> np.ndarray:
        """The last picture, at once. Raises TimeoutError when it is older than that, RuntimeError before the first."""
        assert self._pictures is not None
        picture = self._pictures.latest(self.config.camera)
        if picture is None:
            raise RuntimeError(f"{self} has taken no picture yet")
        age_ms = 1000 * (perf_counter() - picture.taken_s)
        if age_ms > max_age_ms:
            raise TimeoutError(f"the last picture of {self} is {age_ms:.0f} ms old, more than {max_age_ms} ms")
        return picture.pixels

    def _after(self, moment_s: float, timeout_s: float) -> np.ndarray:
        assert self._pictures is not None
        picture = self._pictures.after(self.config.camera, moment_s, timeout_s)
        self._seen_s = picture.taken_s
        return picture.pixels
