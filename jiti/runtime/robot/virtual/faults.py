"""What can be made to go wrong with a virtual arm."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Faults:
    """From the next packet on. Servos go by their ids, 1 to 6."""

    mute: frozenset[int] = frozenset()
    """Servos that do not answer, as with a loose cable. They still hear."""
    corrupt: float = 0.0
    """Share of the status packets, 0 to 1, in which a byte is wrong."""
    slow_s: float = 0.0
    """Wait before each status packet; lerobot gives up after 0.05 s."""
    overload: frozenset[int] = frozenset()
    """Servos that report an overload, with what torque that leaves them."""
    jam: frozenset[int] = frozenset()
    """Servos whose joint does not move."""
    unplugged: bool = False
    """The USB cable is out: the port is gone. The servos keep their power, and hold what they were told to."""
