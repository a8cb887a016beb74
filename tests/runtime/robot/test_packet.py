"""Packets are found in any stream of bytes, however it is cut up."""

from itertools import pairwise

from hypothesis import assume, given
from hypothesis import strategies as st

from jiti.runtime.robot.virtual.packet import BROADCAST, Instruction, Parser, status

INSTRUCTIONS = st.builds(
    Instruction, st.integers(0, BROADCAST), st.sampled_from([1, 2, 3, 4, 5, 0x82, 0x83]), st.binary(max_size=40)
)
NOISE = st.binary(max_size=12).map(lambda noise: noise.replace(b"\xff", b"\xfe"))
"""Without a header, of which no one can tell that it is none."""


def test_a_packet_as_scservo_sdk_writes_it():
    assert Instruction(1, 2, b"\x38\x02").encode() == bytes.fromhex("ff ff 01 04 02 38 02 be")
    assert status(3, 0, b"\xe8\x03") == bytes.fromhex("ff ff 03 04 00 e8 03 0d")


@given(st.lists(st.tuples(NOISE, INSTRUCTIONS), max_size=6), st.lists(st.integers(0, 300), max_size=8))
def test_all_are_found_in_order_wherever_the_stream_is_cut(sent, cuts):
    stream = b"".join(noise + instruction.encode() for noise, instruction in sent)
    edges = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    parser = Parser()
    found = [one for a, b in pairwise(edges) for one in parser.feed(stream[a:b])]
    assert found == [instruction for _, instruction in sent]


@given(INSTRUCTIONS, st.data())
def test_one_with_a_wrong_byte_is_not_taken_and_costs_no_other(instruction, data):
    wrong = bytearray(instruction.encode())
    place = data.draw(st.integers(4, len(wrong) - 1), "place")
    wrong[place] = (wrong[place] + data.draw(st.integers(1, 255), "by")) % 256
    assume(b"\xff" not in wrong[2:])  # which might look like the header of another
    after = Instruction(1, 1)
    assert instruction not in Parser().feed(bytes(wrong))
    assert Parser().feed(bytes(wrong) + after.encode())[-1:] == [after]


@given(st.binary(max_size=400), INSTRUCTIONS)
def test_after_a_pause_whatever_was_begun_is_forgotten(garbage, instruction):
    parser = Parser()
    parser.feed(garbage)
    parser.reset()
    assert parser.feed(instruction.encode()) == [instruction]
