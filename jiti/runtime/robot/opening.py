"""What must be so before an arm gets torque."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jiti.errors import RobotError
from jiti.runtime.robot.complaints import ARM, LEADER
from jiti.runtime.robot.servos import TRIES

if TYPE_CHECKING:
    from lerobot.motors.feetech import FeetechMotorsBus
    from lerobot.robots.so_follower import SOFollower
    from lerobot.teleoperators.so_leader import SOLeader

PARTS = ("homing_offset", "range_min", "range_max")


def check_calibration(robot: "SOFollower | SOLeader", who: str = ARM) -> None:
    """Compare the file with the servos' registers; lerobot would ask on standard input which of them counts.

    Raises RobotError that names joints and numbers.
    """
    config = robot.config
    side, kind, flag = ("robot", "so100_follower", "--robot-id")
    if who == LEADER:
        side, kind, flag = ("teleop", "so100_leader", "--leader-id")
    again = (
        f"`lerobot-calibrate --{side}.type={kind} --{side}.port={config.port} --{side}.id={robot.id}"
        f"{f' --{side}.calibration_dir={config.calibration_dir}' if config.calibration_dir else ''}`"
    )
    if not robot.calibration:
        raise RobotError(f"{who} {robot.id!r} has no calibration at {robot.calibration_fpath}. Make it with {again}.")
    if lacking := [name for name in robot.bus.motors if name not in robot.calibration]:
        raise RobotError(f"{robot.calibration_fpath} has nothing for {', '.join(lacking)}. Make it anew with {again}.")
    differs = [
        f"{name} has {part} {getattr(servo, part)} and not {getattr(robot.calibration[name], part)}"
        for name, servo in robot.bus.read_calibration().items()
        for part in PARTS
        if getattr(servo, part) != getattr(robot.calibration[name], part)
    ]
    if differs:
        raise RobotError(
            f"the servos are not calibrated as {robot.calibration_fpath} says: {'; '.join(differs)}. It is another "
            f"arm's, whose own {flag} gives its file, or a servo was changed: then calibrate with {again}."
        )


def check_range(bus: "FeetechMotorsBus", tolerance_deg: float) -> None:
    """A servo that stands outside its range would go to its end as soon as it has torque. Raises RobotError."""
    for name, position in bus.sync_read("Present_Position", normalize=False, num_retry=TRIES).items():
        found = bus.calibration[name]
        outside = max(found.range_min - position, position - found.range_max) * 360 / 4096
        if outside > tolerance_deg:
            raise RobotError(
                f"servo {bus.motors[name].id} ({name}) stands {outside:.0f} degrees outside the range that it was "
                "calibrated for. Move it by hand into its range; if that does not help, calibrate the arm again."
            )


def configure(robot: "SOFollower") -> None:
    """lerobot's settings of the servos, after which it would turn the torque on, to whatever goal there is."""
    with _torque_stays_off(robot.bus):
        robot.configure()


@contextmanager
def _torque_stays_off(bus: "FeetechMotorsBus") -> Iterator[None]:
    """Instances are asked before classes: lerobot's own method is hidden meanwhile."""
    bus.enable_torque = lambda *_args, **_options: None  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        del bus.enable_torque
