"""Feetech's packets, protocol 0: what is asked of a servo, and what it answers.

    FF FF id length instruction parameters... checksum      length counts from the instruction to the checksum
    FF FF id length error       parameters... checksum      a status packet; words are little-endian

The checksum is the complement of the sum of all bytes between the header and itself. As `scservo_sdk` has it.
"""

from dataclasses import dataclass

HEADER = b"\xff\xff"
BROADCAST = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x04, 0x05, 0x82, 0x83


@dataclass(frozen=True, slots=True)
class Instruction:
    """What one packet asks for."""

    servo: int
    """Id of the servo that is meant, or BROADCAST."""
    code: int
    parameters: bytes = b""

    def encode(self) -> bytes:
        return _framed(self.servo, self.code, self.parameters)


def status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """The answer of a servo, with the bits of `registers.Error`."""
    return _framed(servo, error, parameters)


class Parser:
    """Finds instructions in a stream of bytes that may come in any pieces, with garbage between them.

    A packet with a wrong checksum is no packet: the search goes on at its second byte.
    """

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, received: bytes) -> list[Instruction]:
        """The packets that are complete with these bytes, in their order."""
        self._pending += received
        found = []
        while (start := self._pending.find(HEADER)) >= 0:
            packet = self._pending = self._pending[start:]
            if len(packet) < 4:
                break
            servo, length = packet[2], packet[3]
            if servo > BROADCAST or length < 2:
                self._pending = packet[1:]
                continue
            end = 4 + length
            if len(packet) < end:
                break
            body, checksum = packet[2 : end - 1], packet[end - 1]
            if _checksum(body) != checksum:
                self._pending = packet[1:]
                continue
            found.append(Instruction(servo, body[2], body[3:]))
            self._pending = packet[end:]
        else:
            self._pending = HEADER[:1] if self._pending.endswith(HEADER[:1]) else b""
        return found

    def reset(self) -> None:
        """Forget a packet that was begun: on the wire its bytes follow one another without a pause."""
        self._pending = b""


def _framed(servo: int, code: int, parameters: bytes) -> bytes:
    body = bytes((servo, len(parameters) + 2, code)) + parameters
    return HEADER + body + bytes((_checksum(body),))


def _checksum(body: bytes) -> int:
    return ~sum(body) & 0xFF
