"""Who answers to which instruction, and with what."""

import pytest

from jiti.runtime.robot.virtual import packet, registers
from jiti.runtime.robot.virtual.packet import BROADCAST, Instruction, status
from jiti.runtime.robot.virtual.registers import Error
from jiti.runtime.robot.virtual.servo import Servo
from jiti.runtime.robot.virtual.servo_bus import ServoBus

GOAL = registers.GOAL_POSITION.address


@pytest.fixture
def servos() -> dict[int, Servo]:
    return {k: Servo(k, low_rad=-1.5, high_rad=1.5, mount=0) for k in (1, 2, 3)}


@pytest.fixture
def bus(servos) -> ServoBus:
    return ServoBus(servos)


def goals(servos) -> list[int]:
    return [servo.memory[registers.GOAL_POSITION] for servo in servos.values()]


def test_one_is_pinged_or_all(bus):
    assert bus.handle(Instruction(2, packet.PING)) == [(2, status(2, 0))]
    assert [number for number, _ in bus.handle(Instruction(BROADCAST, packet.PING))] == [1, 2, 3]
    assert bus.handle(Instruction(9, packet.PING)) == []


def test_a_read_gives_the_bytes(bus):
    assert bus.handle(Instruction(1, packet.READ, bytes((3, 2)))) == [(1, status(1, 0, b"\x09\x03"))]


def test_a_write_is_acknowledged_unless_all_are_meant_or_the_servo_is_told_not_to(bus, servos):
    assert bus.handle(Instruction(2, packet.WRITE, bytes((GOAL, 7, 1)))) == [(2, status(2, 0))]
    assert goals(servos) == [0, 263, 0]
    assert bus.handle(Instruction(BROADCAST, packet.WRITE, bytes((GOAL, 5, 0)))) == []
    assert goals(servos) == [5, 5, 5]
    servos[2].memory[registers.STATUS_LEVEL] = 0
    assert bus.handle(Instruction(2, packet.WRITE, bytes((GOAL, 6, 0)))) == []
    assert goals(servos) == [5, 6, 5]


def test_a_prepared_write_waits_for_the_action(bus, servos):
    bus.handle(Instruction(1, packet.REG_WRITE, bytes((GOAL, 9, 0))))
    assert goals(servos) == [0, 0, 0]
    assert bus.handle(Instruction(BROADCAST, packet.ACTION)) == []
    assert goals(servos) == [9, 0, 0]


def test_a_sync_read_is_answered_in_the_order_that_was_asked(bus):
    answers = bus.handle(Instruction(BROADCAST, packet.SYNC_READ, bytes((3, 2, 3, 1, 8))))
    assert answers == [(3, status(3, 0, b"\x09\x03")), (1, status(1, 0, b"\x09\x03"))]


def test_a_sync_write_gives_each_its_own_and_has_no_answer(bus, servos):
    assert bus.handle(Instruction(BROADCAST, packet.SYNC_WRITE, bytes((GOAL, 2, 1, 10, 0, 3, 30, 0)))) == []
    assert goals(servos) == [10, 0, 30]


def test_a_new_id_is_the_one_that_it_goes_by(bus):
    bus.handle(Instruction(3, packet.WRITE, bytes((registers.ID.address, 7))))
    assert bus.handle(Instruction(3, packet.PING)) == []
    assert bus.handle(Instruction(7, packet.PING)) == [(7, status(7, 0))]


def test_an_error_is_in_every_answer(bus, servos):
    servos[1].memory[registers.STATUS] = Error.OVERLOAD
    assert bus.handle(Instruction(1, packet.PING)) == [(1, status(1, 32))]


@pytest.mark.parametrize("code", [packet.READ, packet.WRITE, packet.SYNC_READ, packet.SYNC_WRITE, 0x42])
def test_what_is_cut_short_or_unknown_does_nothing(bus, code):
    assert bus.handle(Instruction(1, code)) == []
