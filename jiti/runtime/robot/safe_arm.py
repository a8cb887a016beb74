"""lerobot's SO100 or SO101 follower, opened, moved and let go without a move that no one asked for.

    with SafeArm(settings) as arm:   # at rest: it can be read, and moved by hand
        arm.engage()                 # stays where it is, with torque
        seen = arm.observe()
        arm.send(goal)
        arm.release()                # at rest again

An arm that is still engaged at the end of `with` is stopped: held where it is while a person takes hold of it, then let
go, servo by servo, whatever fails. So does its watchdog when no command comes.
"""

from collections.abc import Mapping
from contextlib import suppress
from itertools import cycle
from pathlib import Path
from threading import RLock
from time import monotonic, sleep
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from jiti.errors import RobotError
from jiti.runtime.robot import servos
from jiti.runtime.robot.complaints import ARM, cable_out, explained, lost, own_words
from jiti.runtime.robot.limits import GRIPPER, Checked, Joints, limits_of
from jiti.runtime.robot.opening import check_calibration, check_range, configure
from jiti.runtime.robot.port_lock import PortLock
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.teller import Say, Teller
from jiti.runtime.robot.watchdog import Watchdog

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig
    from lerobot.robots.so_follower import SOFollower

TRIES = 3
"""At a reading, within a step: a damaged packet costs 4 ms, an answer that does not come 50. Our choice."""
LOOK_S = 0.2
"""How often a cable that is out is looked for."""


class SafeArm:
    """Its methods are for one thread; the watchdog's thread shares the line with it."""

    def __init__(
        self,
        settings: RobotSettings,
        *,
        cameras: "dict[str, CameraConfig] | None" = None,
        dry: bool = False,
        say: Say = print,
    ) -> None:
        """`cameras` are taken instead of those of the settings. With `dry`, nothing at all is written to the arm. `say`
        is told what a person is to do."""
        from lerobot.robots.so_follower import SO100Follower, SO100FollowerConfig

        folder = Path(settings.calibration_dir).expanduser() if settings.calibration_dir else None
        self.settings, self.dry, self._say = settings, dry, say
        self.robot: SOFollower = SO100Follower(
            SO100FollowerConfig(
                port=settings.port,
                id=settings.id,
                calibration_dir=folder,
                cameras=settings.camera_configs() if cameras is None else cameras,
                num_read_retries=0,
            )
        )
        self._bus = self.robot.bus
        self.joints = tuple(self._bus.motors)
        self.engaged = False
        """Whether a servo may have torque."""
        self.goal: dict[str, float] = {}
        """Where it was sent last, by joint."""
        self.overloads: dict[str, int] = dict.fromkeys(self.joints, 0)
        """Looks at a servo, each five times a second, at which it said that it is overloaded."""
        self.misread = 0
        """Readings that had to be tried again."""
        self._line = RLock()
        self._next_looked_at = cycle(self.joints)
        self._given_up = ""
        self._letting_go = False
        self._watchdog = Watchdog(
            self._hold_by_watchdog,
            self._release_by_watchdog,
            hold_after_s=settings.hold_after_s,
            release_after_s=settings.release_after_s,
        )

    def __enter__(self) -> Self:
        """Raises RobotError, after which the arm is as it was, or at rest."""
        self._lock = PortLock(self.settings.port)
        self._tell = Teller(self._say)
        try:
            self._open()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self.engaged:
                self.stop(error)
        finally:
            self._close()

    def _open(self) -> None:
        with explained(self._bus, ARM, "cannot be opened"):
            servos.connect(self._bus)
            self._lock.exclude()
            servos.tried(self._bus, lambda: check_calibration(self.robot))
            self.limits = servos.tried(self._bus, lambda: limits_of(self._bus, self.settings.max_step))
            if not self.dry:
                servos.tried(self._bus, lambda: configure(self.robot))
            for name, camera in self.robot.cameras.items():
                try:
                    camera.connect()
                except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
                    raise RobotError(
                        f"camera {name!r} does not open: {error}. `lerobot-find-cameras` lists those there are."
                    ) from error
        self.begin_reading()

    def begin_reading(self) -> None:
        """How long the arm was not read until now does not count."""
        self._heard_s = monotonic()
        self._behind_s: dict[str, float] = {}

    def _close(self) -> None:
        for camera in self.robot.cameras.values():
            with suppress(Exception):
                camera.disconnect()
        with suppress(Exception):  # a cable that is out
            self._bus.port_handler.closePort()
        self._lock.release()
        self._tell.close()

    def engage(self) -> None:
        """Turn the torque on where the arm is: its positions become its goals first. Raises RobotError."""
        self.begin_reading()
        if self.dry:
            self.goal = self._read()
            return
        self._given_up, self._letting_go = "", False
        with self._line, explained(self._bus, ARM, "cannot be engaged"):
            check_range(self._bus, self.settings.max_step)
            positions = self._bus.sync_read("Present_Position", normalize=False, num_retry=servos.TRIES)
            self.engaged = True  # what fails from here on is stopped
            for name, position in positions.items():
                self._bus.write("Goal_Position", name, position, normalize=False, num_retry=servos.TRIES)
            self.goal = self._read()
            self._bus.enable_torque(num_retry=servos.TRIES)
        self._watchdog.start()

    def observe(self) -> dict[str, Any] | None:
        """lerobot's observation: angles under `<joint>.pos`, pictures (height, width, 3) uint8 by camera.

        None where the line was too bad this time. Raises RobotError where it stays so, the cable is out, a joint does
        not follow, a servo is overloaded, or a camera gives no picture.
        """
        self._check_watchdog()
        for _ in range(TRIES):
            try:
                with self._line:
                    read = self._bus.sync_read("Present_Position")
            except ConnectionError:
                self.misread += 1
                self._settle()
                continue
            except servos.CABLE_OUT as error:
                raise self._cable_out() from error
            self._heard_s = monotonic()
            self._check_follows(read)
            self._look_at(next(self._next_looked_at))
            return {f"{name}.pos": position for name, position in read.items()} | self._pictures()
        if monotonic() - self._heard_s > self.settings.lost_s:
            raise self._lost()
        return None

    def send(self, asked: Joints) -> Checked:
        """Go to a place (degrees by joint), as far as the limits allow. Raises RobotError for what is no place, then
        without sending anything, or when the cable is out."""
        self._check_watchdog()
        checked = self.limits.check(asked, self.goal)
        self._send(checked.goal)
        return checked

    def hold(self) -> None:
        """Stay at the last goal: what to send when there is nothing to send. Raises RobotError."""
        self._check_watchdog()
        self._send(self.goal)

    def release(self) -> None:
        """Take the torque from every servo. Raises RobotError that names those that did not confirm it; the arm is
        engaged then, and may be released again."""
        self._watchdog.stop()
        if not self.engaged:
            return
        self._letting_go = True
        if silent := self._let_go():
            warning = (
                f"{servos.told(self._bus, silent)} did not say that its torque is off. Hold the arm, and switch its "
                "power off; then check the cable to that servo."
            )
            self._tell(warning)  # at once: the error is told when all is saved
            raise RobotError(warning)
        self.engaged = False

    def stop(self, because: BaseException | None = None) -> None:
        """Hold the arm where it is, unless it was being let go, then release it. Raises RobotError like `release`,
        which then also tells what the arm was stopped for, and what its watchdog did."""
        self._watchdog.stop()
        try:
            if self.engaged and not self._letting_go:
                with suppress(*servos.CABLE_OUT), self._line:  # then `release` says what is to be done
                    servos.freeze(self._bus)
                    self._tell(f"Take hold of the arm: its torque goes off in {self.settings.release_after_s:g} s.")
                    sleep(self.settings.release_after_s)
        finally:
            try:
                self.release()
            except RobotError as worse:
                raise RobotError(_joined(because or "", self._given_up, worse)) from because or worse

    def _let_go(self) -> list[str]:
        """Names of servos that did not confirm it. A cable that is out is waited for."""
        end = monotonic() + self.settings.replug_s
        while True:
            try:
                with self._line:
                    return servos.turn_off(self._bus)
            except servos.CABLE_OUT:
                self._wait_for_cable(end)

    def _wait_for_cable(self, end: float) -> None:
        port = self.settings.port
        self._tell(
            f"{port} is gone, and the servos keep their torque. Plug the cable in again within "
            f"{self.settings.replug_s:g} s, or hold the arm and switch its power off."
        )
        while monotonic() < end:
            sleep(LOOK_S)
            if self._opened_again():
                return
        warning = f"{port} did not come back: all servos may still have torque. Hold the arm, and switch its power off."
        self._tell(warning)
        raise RobotError(warning)

    def _opened_again(self) -> bool:
        with suppress(*servos.CABLE_OUT):
            self._bus.port_handler.closePort()
        self._lock.release()  # first, because the new port may be the old device
        try:
            self._lock = PortLock(self.settings.port)
            self._bus.port_handler.openPort()
        except (RobotError, *servos.CABLE_OUT):
            return False
        servos.prepare(self._bus)
        return True

    def _send(self, goal: Joints) -> None:
        if not self.dry:
            try:
                with self._line:
                    self._check_watchdog()  # which may have let the arm go while the line was waited for
                    self.robot.send_action({f"{name}.pos": angle for name, angle in goal.items()})
                    self.goal = dict(goal)
            except servos.CABLE_OUT as error:
                raise self._cable_out() from error
        else:
            self.goal = dict(goal)
        self._watchdog.feed()

    def _read(self) -> dict[str, float]:
        return self._bus.sync_read("Present_Position", num_retry=servos.TRIES)

    def _pictures(self) -> dict[str, Any]:
        """The latest of each camera."""
        pictures = {}
        for name, camera in self.robot.cameras.items():
            try:
                pictures[name] = camera.read_latest()
            except (RuntimeError, OSError) as error:  # TimeoutError and ConnectionError are OSErrors
                raise RobotError(f"camera {name!r} gives no picture: {own_words(error)}. Check its cable.") from error
        return pictures

    def _settle(self) -> None:
        with self._line:
            servos.settle(self._bus)

    def _check_follows(self, positions: Mapping[str, float]) -> None:
        if not self.engaged:
            return
        now = monotonic()
        for name, position in positions.items():
            lag = abs(position - self.goal[name])
            if name == GRIPPER or lag <= self.settings.max_lag:
                self._behind_s.pop(name, None)
            elif now - self._behind_s.setdefault(name, now) > self.settings.lag_s:
                raise RobotError(
                    f"{servos.told(self._bus, [name])} stays {lag:.0f} degrees from where it was sent. Free what "
                    "blocks it, or check its horn and its gear."
                )

    def _look_at(self, name: str) -> None:
        """Ask a servo for its errors, which reading all positions hides."""
        try:
            with self._line:
                self._bus.read("Status", name)
        except RuntimeError as error:
            what = str(error).rpartition("]")[2].strip(" !").lower()
            overload = "overload" in what
            self.overloads[name] += overload
            if name != GRIPPER or not overload:  # it overloads when it holds a thing for long, and keeps holding it
                raise RobotError(
                    f"{servos.told(self._bus, [name])} reports an {what}. Free it, let it cool down, and check its "
                    "voltage."
                ) from error
        except ConnectionError:
            self.misread += 1
            self._settle()
        except servos.CABLE_OUT as error:
            raise self._cable_out() from error

    def _check_watchdog(self) -> None:
        if self._given_up:
            raise RobotError(self._given_up)

    def _hold_by_watchdog(self) -> None:
        after_s = self.settings.release_after_s
        with suppress(*servos.CABLE_OUT), self._line:
            servos.freeze(self._bus)
            self.goal = self._read()  # from where a command that comes late goes on
        self._tell(f"No command for {self.settings.hold_after_s:g} s: the arm is held, and let go in {after_s:g} s.")

    def _release_by_watchdog(self) -> None:
        self._given_up = (
            f"the arm was let go, because no command came for "
            f"{self.settings.hold_after_s + self.settings.release_after_s:g} s: this program hung, or was stopped. "
            "End other work on this machine, and start again."
        )
        try:
            self.release()
        except RobotError as error:
            self._given_up += f" {error}"

    def _cable_out(self) -> RobotError:
        return cable_out(self._bus, ARM)

    def _lost(self) -> RobotError:
        with self._line:
            return lost(self._bus, ARM, self.settings.lost_s)


def _joined(*told: object) -> str:
    """What was told, without what another part of it has told already."""
    whole = ""
    for part in map(str, told):
        whole = whole if part in whole else part if whole in part else f"{whole} {part}"
    return whole
