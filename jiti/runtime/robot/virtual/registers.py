"""The memory of one STS3215: what its bytes mean, what they are when it leaves the factory, and how signs are written.

Addresses are lerobot's (`lerobot/motors/feetech/tables.py`), defaults those of Feetech's memory table for the STS
series (https://wiki.aifitlab.com/feetech-servo-motor-docs/feetech-sts-servo-memory-table-analysis) and, for model and
firmware, what an SO100's servos answer.
"""

from dataclasses import dataclass
from enum import IntFlag

STEPS = 4096
"""Of the encoder, in one turn."""
MODEL, FIRMWARE = 777, (3, 10)
"""The STS3215 by its number; major and minor."""


class Error(IntFlag):
    """Bits of a status packet's error byte, which are those of the register `Status`."""

    VOLTAGE = 1
    ANGLE = 2
    OVERHEAT = 4
    CURRENT = 8
    OVERLOAD = 32


@dataclass(frozen=True, slots=True)
class Register:
    """A number in the servo's memory, of one byte or two."""

    address: int
    size: int = 1
    default: int = 0
    sign_bit: int | None = None
    """Where the number is sign and magnitude: the bit that says it is negative."""

    @property
    def most(self) -> int:
        """Its greatest magnitude."""
        return (1 << (8 * self.size if self.sign_bit is None else self.sign_bit)) - 1

    def encode(self, value: int) -> bytes:
        """Little-endian; a magnitude that is too great becomes the greatest there is."""
        raw = min(abs(value), self.most)
        if self.sign_bit is not None and value < 0:
            raw |= 1 << self.sign_bit
        return raw.to_bytes(self.size, "little")

    def decode(self, raw: bytes) -> int:
        value = int.from_bytes(raw, "little")
        if self.sign_bit is None:
            return value
        magnitude = value & self.most
        return -magnitude if value >> self.sign_bit & 1 else magnitude


# Kept without power.
FIRMWARE_MAJOR = Register(0, default=FIRMWARE[0])
FIRMWARE_MINOR = Register(1, default=FIRMWARE[1])
MODEL_NUMBER = Register(3, 2, MODEL)
ID = Register(5, default=1)
STATUS_LEVEL = Register(8, default=1)  # 0: answers to PING and READ only
MIN_POSITION, MAX_POSITION = Register(9, 2), Register(11, 2, STEPS - 1)  # in steps, after the offset
MAX_TEMPERATURE, MAX_VOLTAGE, MIN_VOLTAGE = Register(13, default=70), Register(14, default=80), Register(15, default=40)
MAX_TORQUE = Register(16, 2, 1000)  # in 0.1% of the stall torque
PHASE = Register(18, default=12)  # bit 4: positions count turns
UNLOADING, ALARM = Register(19, default=44), Register(20, default=47)
P_COEFFICIENT, D_COEFFICIENT, I_COEFFICIENT = Register(21, default=32), Register(22, default=32), Register(23)
MIN_STARTUP = Register(24, 2, 16)
CW_DEAD_ZONE, CCW_DEAD_ZONE = Register(26, default=1), Register(27, default=1)
PROTECTION_CURRENT = Register(28, 2, 500)
RESOLUTION = Register(30, default=1)
OFFSET = Register(31, 2, sign_bit=11)  # in steps: position = encoder - offset
MODE = Register(33)
PROTECTIVE_TORQUE = Register(34, default=20)  # in % of the stall torque, what is left of it after an overload
PROTECTION_TIME = Register(35, default=200)  # in 10 ms
OVERLOAD_TORQUE = Register(36, default=80)  # in % of the stall torque
# Lost without power.
TORQUE_ENABLE = Register(40)
ACCELERATION = Register(41)  # in 100 steps/s2; 0: none to keep to
GOAL_POSITION = Register(42, 2, sign_bit=15)
GOAL_TIME = Register(44, 2)
GOAL_VELOCITY = Register(46, 2, sign_bit=15)  # in steps/s; 0: as fast as it can
TORQUE_LIMIT = Register(48, 2, 1000)
LOCK = Register(55, default=1)
# Measured.
PRESENT_POSITION = Register(56, 2, sign_bit=15)
PRESENT_VELOCITY = Register(58, 2, sign_bit=15)  # in steps/s
PRESENT_LOAD = Register(60, 2, sign_bit=10)  # in 0.1% of the stall torque
PRESENT_VOLTAGE = Register(62, default=74)  # in 0.1 V
PRESENT_TEMPERATURE = Register(63, default=30)  # in degrees Celsius
STATUS = Register(65)
MOVING = Register(66)
PRESENT_CURRENT = Register(69, 2)  # in 6.5 mA
GOAL_IN_USE = Register(71, 2)
MAX_ACCELERATION = Register(85)

_REGISTERS = tuple(value for value in list(globals().values()) if isinstance(value, Register))
_READ_ONLY = frozenset((*range(5), *range(56, 80)))
SIZE = 128
"""In bytes: our choice, as all that lerobot names lies below."""


class Memory:
    """The bytes of one servo."""

    def __init__(self, servo: int) -> None:
        self._bytes = bytearray(SIZE)
        for register in _REGISTERS:
            self[register] = register.default
        self[ID] = servo

    def __getitem__(self, register: Register) -> int:
        return register.decode(self.read(register.address, register.size))

    def __setitem__(self, register: Register, value: int) -> None:
        self._bytes[register.address : register.address + register.size] = register.encode(value)

    def read(self, address: int, size: int) -> bytes:
        """Bytes from an address on; 0 past the end."""
        return bytes(self._bytes[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, values: bytes) -> None:
        """Set bytes from an address on; those that are read-only, or past the end, stay as they are."""
        for place, value in enumerate(values, start=address):
            if place < SIZE and place not in _READ_ONLY:
                self._bytes[place] = value
