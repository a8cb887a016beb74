"""A servo's memory keeps what is written where it may be, and agrees with lerobot about what lies where."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.runtime.robot.virtual import registers as r


@given(st.data())
def test_what_is_set_is_read_with_its_sign(data):
    register = data.draw(st.sampled_from(r._REGISTERS), "register")
    least = 0 if register.sign_bit is None else -register.most
    value = data.draw(st.integers(least, register.most), "value")
    memory = r.Memory(1)
    memory[register] = value
    assert memory[register] == value
    assert register.decode(memory.read(register.address, register.size)) == value


def test_what_is_measured_cannot_be_written():
    memory = r.Memory(4)
    memory.write(0, bytes([1] * 256))
    assert (memory[r.MODEL_NUMBER], memory[r.PRESENT_VOLTAGE]) == (r.MODEL, 74)
    assert memory[r.TORQUE_ENABLE] == 1
    assert memory.read(200, 3) == bytes(3)


def test_lerobot_has_the_same_addresses_sizes_and_signs():
    tables = pytest.importorskip("lerobot.motors.feetech.tables", reason="pip install 'jiti[robot]'")
    theirs = tables.MODEL_CONTROL_TABLE["sts3215"]
    names = {
        "MODEL_NUMBER": "Model_Number",
        "MIN_POSITION": "Min_Position_Limit",
        "MAX_POSITION": "Max_Position_Limit",
        "MAX_TORQUE": "Max_Torque_Limit",
        "OFFSET": "Homing_Offset",
        "OVERLOAD_TORQUE": "Overload_Torque",
        "TORQUE_ENABLE": "Torque_Enable",
        "GOAL_POSITION": "Goal_Position",
        "GOAL_VELOCITY": "Goal_Velocity",
        "PRESENT_POSITION": "Present_Position",
        "PRESENT_VELOCITY": "Present_Velocity",
        "PRESENT_LOAD": "Present_Load",
        "MAX_ACCELERATION": "Maximum_Acceleration",
    }
    for ours, name in names.items():
        register = getattr(r, ours)
        assert (register.address, register.size) == theirs[name], name
        assert register.sign_bit == tables.MODEL_ENCODING_TABLE["sts3215"].get(name), name
