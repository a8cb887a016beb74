"""lerobot's SO100 or SO101 leader, read: an arm that a person moves, and that another one follows.

with Leader(settings) as leader:   # without torque, from here on
    place = leader.read()          # degrees by joint, as the follower's
"""

from contextlib import suppress
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Self

from jiti.errors import RobotError
from jiti.runtime.robot import servos
from jiti.runtime.robot.complaints import LEADER, cable_out, explained, lost
from jiti.runtime.robot.limits import Joints
from jiti.runtime.robot.opening import check_calibration
from jiti.runtime.robot.port_lock import PortLock
from jiti.runtime.robot.safe_arm import TRIES
from jiti.runtime.robot.settings import RobotSettings

if TYPE_CHECKING:
    from lerobot.teleoperators.so_leader import SOLeader


class Leader:
    """For one thread."""

    def __init__(self, settings: RobotSettings) -> None:
        """Of the settings, those that begin with `leader`, and `lost_s`."""
        from lerobot.teleoperators.so_leader import SO100Leader, SO100LeaderConfig

        folder = settings.leader_calibration_dir
        config = SO100LeaderConfig(
            port=settings.leader,
            id=settings.leader_id,
            calibration_dir=Path(folder).expanduser() if folder else None,
            num_read_retries=0,
        )
        self._leader: SOLeader = SO100Leader(config)
        self._bus, self._lost_s = self._leader.bus, settings.lost_s

    def __enter__(self) -> Self:
        """Raises RobotError; nothing is asked on standard input."""
        try:
            self._lock = PortLock(self._bus.port)
        except RobotError as error:
            raise RobotError(f"the leader: {error}") from error
        try:
            with explained(self._bus, LEADER, "cannot be opened"):
                servos.connect(self._bus)
                self._lock.exclude()
                servos.tried(self._bus, lambda: check_calibration(self._leader, LEADER))
                servos.tried(self._bus, self._leader.configure)  # which takes the torque from it
        except BaseException:
            self._close()
            raise
        self.begin_reading()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def begin_reading(self) -> None:
        """How long it was not read until now does not count."""
        self._heard_s = monotonic()

    def read(self) -> Joints | None:
        """Where it is, as the follower is to be; None where the line was too bad this time.

        Raises RobotError where it stays so, or the cable is out.
        """
        for _ in range(TRIES):
            try:
                read = self._leader.get_action()
            except ConnectionError:
                servos.settle(self._bus)
                continue
            except servos.CABLE_OUT as error:
                raise cable_out(self._bus, LEADER) from error
            self._heard_s = monotonic()
            return {name.removesuffix(".pos"): angle for name, angle in read.items()}
        if monotonic() - self._heard_s > self._lost_s:
            raise lost(self._bus, LEADER, self._lost_s)
        return None

    def _close(self) -> None:
        with suppress(Exception):  # a cable that is out
            self._bus.port_handler.closePort()
        self._lock.release()
