"""Servos on one line: who is meant by an instruction, what it does to them, and what they answer.

What a write does to the motor shows from its next control step on; the answer has the error that there was before.
"""

from collections.abc import Iterator, Mapping

from jiti.runtime.robot.virtual import packet, registers
from jiti.runtime.robot.virtual.packet import Instruction
from jiti.runtime.robot.virtual.servo import Servo


class ServoBus:
    def __init__(self, servos: Mapping[int, Servo]) -> None:
        self._servos = tuple(servos.values())
        self._prepared: dict[int, bytes] = {}

    def handle(self, instruction: Instruction) -> list[tuple[int, bytes]]:
        """Carry out an instruction; ids of the servos that answer, with their status packets, in order.

        One that is cut short, or unknown, does nothing.
        """
        given = instruction.parameters
        meant = dict(self._meant(instruction.servo))
        match instruction.code:
            case packet.PING:
                return [self._answer(number, servo) for number, servo in meant.items()]
            case packet.READ if len(given) == 2:
                return [self._answer(number, servo, *given) for number, servo in meant.items()]
            case packet.WRITE if given:
                answers = self._acknowledge(instruction.servo, meant)
                for servo in meant.values():
                    servo.write(given[0], given[1:])
                return answers
            case packet.REG_WRITE if given:
                self._prepared |= dict.fromkeys(meant, given)
                return self._acknowledge(instruction.servo, meant)
            case packet.ACTION:
                for number in meant.keys() & self._prepared.keys():
                    address, *values = self._prepared.pop(number)
                    meant[number].write(address, bytes(values))
                return self._acknowledge(instruction.servo, meant)
            case packet.SYNC_READ if len(given) > 2:
                there = dict(self._meant(packet.BROADCAST))
                return [self._answer(n, there[n], given[0], given[1]) for n in given[2:] if n in there]
            case packet.SYNC_WRITE if len(given) > 2:
                address, size = given[:2]
                there = dict(self._meant(packet.BROADCAST))
                for start in range(2, len(given) - size, size + 1):
                    if given[start] in there:
                        there[given[start]].write(address, given[start + 1 : start + 1 + size])
        return []

    def _meant(self, number: int) -> Iterator[tuple[int, Servo]]:
        """By the ids that the servos have now."""
        for servo in self._servos:
            own = servo.memory[registers.ID]
            if number in (own, packet.BROADCAST):
                yield own, servo

    def _acknowledge(self, number: int, meant: Mapping[int, Servo]) -> list[tuple[int, bytes]]:
        if number == packet.BROADCAST:
            return []
        return [self._answer(n, servo) for n, servo in meant.items() if servo.memory[registers.STATUS_LEVEL]]

    @staticmethod
    def _answer(number: int, servo: Servo, address: int = 0, size: int = 0) -> tuple[int, bytes]:
        return number, packet.status(number, servo.error, servo.memory.read(address, size))
