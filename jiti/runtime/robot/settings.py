"""How an arm is reached and how far it may go, from a TOML file and flags."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.tasks.toml_lines import line_of, read_toml

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig

KINDS = ("so100", "so101")
"""lerobot drives both with one class."""
VIRTUAL = "virtual"
"""As a port: an arm that is simulated."""


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Joints are in lerobot's units: degrees from the middle of a joint's range, and percent for the gripper."""

    kind: str = "so100"
    port: str = ""
    """`/dev/ttyACM0`; `virtual` for an arm that is simulated."""
    id: str = "follower"
    """By which lerobot finds its calibration."""
    calibration_dir: str = ""
    """Where that is; empty: where `lerobot-calibrate` puts it."""
    leader: str = ""
    """Port of an arm that a person moves and this one follows, when demonstrations are recorded; `virtual` where this
    one is."""
    leader_id: str = "leader"
    leader_calibration_dir: str = ""
    fps: int = 30
    """Actions a second. The paper's arms and lerobot's recordings have 30."""
    max_step: float = 5.0
    """Most by which a goal may differ from the one before it. Our choice: 150 degrees a second, half of what the servo
    does without load."""
    max_lag: float = 20.0
    """How far a joint may be from its goal for `lag_s`; not the gripper, which is to press on things. Our choice: more
    than a moving arm lags behind, less than a push that bends something."""
    lag_s: float = 1.0
    lost_s: float = 0.5
    """For how long the arm may not be read before it is given up. Our choice: a corrupt packet is nothing, fifteen
    steps without an answer are a cable."""
    hold_after_s: float = 0.5
    """Without a command for so long, the arm is held where it is. Our choice: fifteen steps."""
    release_after_s: float = 2.0
    """Held for so long, it is let go: the time in which a person can take hold of it. Our choice."""
    replug_s: float = 10.0
    """How long an arm whose cable is out is waited for, to let it go."""
    stall_s: float = 10.0
    """How long a decision may take. Our choice: SmolVLA with 8 candidates takes under one second on a GPU."""
    execute: int = 0
    """Actions of a chunk from one decision to the next; 0: as many as the policy means to, at most half a chunk."""
    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By name, lerobot's fields: `type = "opencv"`, `index_or_path`, `width`, `height`, `fps`."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"kind is {self.kind!r}; {nearest(self.kind, KINDS)}.")
        for name in (f.name for f in fields(self) if f.type is float or f.name == "fps"):
            if not 0 < getattr(self, name) < float("inf"):
                raise UsageError(f"{name} is {getattr(self, name)}; it must be above 0.")
        if self.execute < 0:
            raise UsageError(f"execute is {self.execute}; it must be 1 or more, or 0 for half a chunk.")

    def check_port(self) -> None:
        """Raises UsageError where none was named."""
        if not self.port:
            raise UsageError("which port? Pass --port /dev/ttyACM0 (`lerobot-find-port` tells it), or --port virtual.")

    @property
    def period_s(self) -> float:
        return 1 / self.fps

    def camera_configs(self) -> "dict[str, CameraConfig]":
        """lerobot's. Raises UsageError for what it does not know."""
        from importlib import import_module

        import draccus
        from lerobot.cameras import CameraConfig

        for module in ("opencv", "realsense", "zmq"):
            import_module(f"lerobot.cameras.{module}")  # lerobot knows them once they are imported
        found = {}
        for name, content in self.cameras.items():
            try:
                found[name] = draccus.decode(CameraConfig, dict(content))
            except (draccus.ParsingError, ValueError, TypeError) as error:
                known = ", ".join(CameraConfig.get_known_choices())
                raise UsageError(f"camera {name!r}: {error}. `type` is one of {known}; see docs/so100.md.") from error
        return found


def read_settings(path: Path | None, **flags: Any) -> RobotSettings:
    """The settings of a TOML file, with the flags that were given (not None) in their place.

    Raises UsageError, which names the line, for a key that there is not, or a value that cannot be.
    """
    made = RobotSettings()
    if path is not None:
        content, lines = read_toml(path, f"--robot-config {path}", "Pass a TOML file as in docs/so100.md.")
        known = {f.name: f.type for f in fields(RobotSettings)}
        for key, value in content.items():
            at = f"{path.name}, line {line_of(lines, (key,))}: "
            if key not in known:
                raise UsageError(f"{at}there is no key {key!r}; {nearest(key, known)}.")
            if not _fits(value, known[key]):
                raise UsageError(f"{at}{key} is {value!r}; it must be {_wanted(known[key])}.")
            try:
                made = replace(made, **{key: value})
            except UsageError as error:
                raise UsageError(f"{at}{error}") from error
    return replace(made, **{key: value for key, value in flags.items() if value is not None})


def _fits(value: Any, kind: Any) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind in (str, int):
        return isinstance(value, kind) and not isinstance(value, bool)
    return isinstance(value, Mapping) and all(isinstance(one, Mapping) for one in value.values())


def _wanted(kind: Any) -> str:
    return {float: "a number", int: "a whole number", str: "a text"}.get(kind, "sections [cameras.NAME]")
