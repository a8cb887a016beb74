"""Six servos on a line that may be broken: each is asked for itself, so that one that is mute does not stop the others.

lerobot raises ConnectionError where there is no answer or a damaged one, RuntimeError where an answer has an error bit,
and lets `termios.error` and OSError through when the cable is out. Its `disconnect` ends at the first of these.
"""

import errno
import termios
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lerobot.motors.feetech import FeetechMotorsBus

CABLE_OUT = (termios.error, OSError)
"""ConnectionError, which is an OSError too, is caught before these where it means less."""
SILENT = (ConnectionError, *CABLE_OUT)
TRIES = 5
"""lerobot's, to turn the torque off."""
WRITE_S = 0.5
"""In which the port must take a packet. Our choice: a packet takes 0.3 ms."""
OPENINGS = 3
"""Times that what opens an arm is tried. Our choice: a packet that was lost is no servo that is missing."""


def connect(bus: "FeetechMotorsBus") -> None:
    """Open the port and find all servos. Raises what lerobot's `connect` does, which looks once."""
    for left in reversed(range(OPENINGS)):
        try:
            bus.connect()
        except RuntimeError:
            if not left:
                raise
            bus.port_handler.closePort()
        else:
            prepare(bus)
            return


def prepare(bus: "FeetechMotorsBus") -> None:
    """Of a port that was just opened: writing ends, and a signal is none of its errors."""
    serial = bus.port_handler.ser
    serial.write_timeout = WRITE_S
    serial.flush = partial(_uninterrupted, serial.flush)


def _uninterrupted(flush: Callable[[], None]) -> None:
    """`termios.tcdrain` is not called again after a signal, as Python's other calls are (PEP 475)."""
    while True:
        try:
            return flush()
        except termios.error as error:
            if error.args[0] != errno.EINTR:
                raise


def tried[T](bus: "FeetechMotorsBus", work: Callable[[], T]) -> T:
    """What it gives, where lerobot itself tries once; it may be done twice. Raises ConnectionError."""
    for left in reversed(range(OPENINGS)):
        try:
            return work()
        except ConnectionError:
            if not left:
                raise
            settle(bus)
    raise AssertionError


def settle(bus: "FeetechMotorsBus") -> None:
    """Forget what a broken exchange left: bytes that came late, and the mark that one is going on."""
    bus.port_handler.is_using = False
    with suppress(*CABLE_OUT):
        bus.port_handler.ser.reset_input_buffer()


def freeze(bus: "FeetechMotorsBus") -> None:
    """Make of every servo's position its goal; those that do not answer keep the goal that they have.

    Raises what means that the cable is out.
    """
    positions: dict[str, float] = {}
    for name in bus.motors:
        positions |= _position(bus, name)
    with suppress(ConnectionError):
        if positions:
            bus.sync_write("Goal_Position", positions, normalize=False)


def turn_off(bus: "FeetechMotorsBus") -> list[str]:
    """Take the torque from every servo, whatever the others do; names of those that did not confirm it.

    Raises what means that the cable is out.
    """
    settle(bus)
    # All at once and first: a servo that is only not heard hears this.
    with suppress(ConnectionError):
        bus.sync_write("Torque_Enable", 0, num_retry=1)
    return [name for name in bus.motors if not _confirmed(bus, name)]


def _confirmed(bus: "FeetechMotorsBus", name: str) -> bool:
    for _ in range(TRIES):
        try:
            bus.write("Torque_Enable", name, 0)
        except ConnectionError:
            settle(bus)
            continue
        except RuntimeError:
            pass  # it answered, with an error bit: an overload, say, ends with this
        return True
    return False


def mute(bus: "FeetechMotorsBus") -> list[str]:
    """Servos that do not answer. Raises what means that the cable is out."""
    return [name for name in bus.motors if not _position(bus, name)]


def _position(bus: "FeetechMotorsBus", name: str) -> dict[str, float]:
    """Of one servo, in its steps; empty where it does not answer."""
    for _ in range(3):
        settle(bus)
        with suppress(ConnectionError):
            # Unlike `read`, it does not mind an overload.
            return bus.sync_read("Present_Position", [name], normalize=False)
    return {}


def told(bus: "FeetechMotorsBus", names: Iterable[str]) -> str:
    """`servo 3 (elbow_flex), servo 4 (wrist_flex)`"""
    return ", ".join(f"servo {bus.motors[name].id} ({name})" for name in names)
