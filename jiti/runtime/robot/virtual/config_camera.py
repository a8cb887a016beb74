"""The configuration of a virtual arm's camera, which lerobot knows as `virtual`.

lerobot finds the camera's class by this module's name and the configuration's.
"""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig  # noqa: TID253 - this module is lerobot's plugin


@CameraConfig.register_subclass("virtual")
@dataclass(kw_only=True)
class VirtualCameraConfig(CameraConfig):
    """Which camera of which arm, with lerobot's `fps`, `width` and `height`."""

    port: str
    """Of the virtual arm, which is open in this process."""
    camera: str = "front"
    """front or wrist."""
    fps: int = 30  # pyright: ignore[reportIncompatibleVariableOverride]
    width: int = 320  # pyright: ignore[reportIncompatibleVariableOverride]
    height: int = 240  # pyright: ignore[reportIncompatibleVariableOverride]
