"""How videos are encoded: settings that lerobot's readers take, and what info.json says of them."""

from dataclasses import dataclass
from typing import Any, Literal

from jiti.errors import UsageError

Name = Literal["h264", "hevc", "av1"]
ENCODERS: dict[str, str] = {"h264": "libx264", "hevc": "libx265", "av1": "libsvtav1"}
"""FFmpeg's encoder of each; the names are those that lerobot and FFmpeg's readers use."""
PIXELS = "yuv420p"
"""Of all of them, as lerobot's default (lerobot/configs/video.py)."""
KEY_FRAME_PERIOD = 2
"""Frames from one key frame to the next: lerobot's default, so that a random frame needs two to be decoded."""
QUALITY = {"h264": 23, "hevc": 28, "av1": 30}
"""Constant rate factor. x264's and x265's own defaults; lerobot's for AV1. Lower is better and larger."""
WORST = {"h264": 51, "hevc": 51, "av1": 63}
"""The largest constant rate factor that each encoder takes with 8 bits a colour: x264's, x265's, SVT-AV1's."""
PRESETS = {"h264": "superfast", "hevc": "ultrafast", "av1": "12"}
"""Speed. Our choice, measured (benchmarks/curate.py); lerobot's for AV1."""
THREADS = 2
"""Of one encoder. A fixed number, because the bytes depend on it and not only the time. Our choice."""


@dataclass(frozen=True, slots=True)
class Codec:
    """One way to encode."""

    name: Name = "h264"
    quality: int | None = None
    """Constant rate factor; None for the codec's in `QUALITY`."""

    def __post_init__(self) -> None:
        if self.name not in ENCODERS:
            raise UsageError(f"--codec {self.name} is not one of {', '.join(ENCODERS)}.")
        if self.quality is not None and not 0 <= self.quality <= WORST[self.name]:
            raise UsageError(f"--crf {self.quality} is not in 0 to {WORST[self.name]}, which {self.name} takes.")

    @property
    def encoder(self) -> str:
        return ENCODERS[self.name]

    @property
    def crf(self) -> int:
        return QUALITY[self.name] if self.quality is None else self.quality

    @property
    def options(self) -> dict[str, str]:
        """For FFmpeg."""
        options = {"g": str(KEY_FRAME_PERIOD), "crf": str(self.crf), "preset": PRESETS[self.name]}
        match self.name:
            case "h264":
                return options | {"threads": str(THREADS), "bf": "0", "sc_threshold": "0"}
            case "hevc":
                # Its key frames are set by its own parameters; its log goes to the terminal.
                own = f"log-level=error:keyint={KEY_FRAME_PERIOD}:min-keyint=1:bframes=0:scenecut=0:pools={THREADS}"
                return {**options, "x265-params": own}
            case _:
                return options | {"svtav1-params": f"fast-decode=0:lp={THREADS}"}

    def to_info(self, width: int, height: int, fps: int) -> dict[str, Any]:
        """What lerobot notes of a video that it encoded (lerobot/datasets/video_utils.py, get_video_info)."""
        return {
            "video.height": height,
            "video.width": width,
            "video.codec": self.name,
            "video.pix_fmt": PIXELS,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
            "video.g": KEY_FRAME_PERIOD,
            "video.crf": self.crf,
            "video.preset": PRESETS[self.name],
            "video.fast_decode": 0,
            "video.video_backend": "pyav",
            "video.extra_options": {},
            "is_depth_map": False,
        }
