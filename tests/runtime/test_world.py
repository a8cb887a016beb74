"""What is asked of a scene by name, on a small model whose answers are known."""

from collections.abc import Iterator

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.sim.world import Names, World

pytestmark = pytest.mark.sim
mujoco = pytest.importorskip("mujoco")

MODEL = """
<mujoco>
  <worldbody>
    <body name="can_1_main" pos="0 0 0.5"><freejoint/><geom name="can" type="cylinder" size="0.03 0.05"/></body>
    <body name="box_1_main" pos="0.5 0 0.5"><freejoint/><geom name="box" type="box" size="0.1 0.02 0.03"/></body>
    <body name="tray_1_main" pos="0 0 0">
      <geom name="floor" type="box" size="0.2 0.2 0.01"/>
      <geom name="wall" type="box" size="0.01 0.2 0.1" pos="0.2 0 0.1"/>
      <site name="tray_1_region" type="box" size="0.1 0.1 0.05" pos="0 0 0.06"/>
    </body>
    <body name="case_1_main" pos="0 1 0">
      <geom name="case" type="box" size="0.1 0.1 0.1"/>
      <body name="drawer"><joint name="slide" type="slide" axis="0 1 0" range="-0.2 0.01"/>
        <geom name="front" type="box" size="0.1 0.01 0.05" pos="0 -0.12 0"/>
        <site name="case_1_drawer" pos="0 -0.1 0" size="0.05 0.05 0.05" type="box"/></body>
    </body>
    <body name="oven_1_main" pos="0 2 0">
      <geom name="oven" type="box" size="0.1 0.1 0.1"/>
      <body name="door" pos="-0.1 -0.12 0"><joint name="hinge" type="hinge" axis="0 0 1" range="-2 0"/>
        <geom name="panel" type="box" size="0.1 0.01 0.1" pos="0.1 0 0"/></body>
    </body>
    <body name="gripper0_hand" pos="0 0 2">
      <geom name="gripper0_finger1" type="box" size="0.01 0.01 0.02" pos="0 0.04 0"/>
      <geom name="gripper0_finger2" type="box" size="0.01 0.01 0.02" pos="0 -0.04 0"/>
    </body>
  </worldbody>
</mujoco>
"""
NAMES = Names(
    ("can_1", "box_1"),
    ("tray_1", "case_1", "oven_1"),
    {"tray_1_region": "tray_1", "case_1_drawer": "case_1", "table_region": None},
)


@pytest.fixture
def world() -> Iterator[World]:
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return World(model, data, NAMES)


def put(world: World, name: str, at: list[float], wxyz: list[float] | None = None) -> None:
    address = int(world.model.jnt_qposadr[world.model.body(f"{name}_main").jntadr[0]])
    world.data.qpos[address : address + 3] = at
    world.data.qpos[address + 3 : address + 7] = wxyz or [1, 0, 0, 0]
    mujoco.mj_forward(world.model, world.data)


@pytest.mark.parametrize("tilt", [0.0, 0.3, np.pi / 2, 2.0])
def test_the_lowest_point_of_a_tilted_can_is_on_its_edge(world, tilt):
    put(world, "can_1", [0, 0, 1], [np.cos(tilt / 2), np.sin(tilt / 2), 0, 0])
    assert world.lowest_m("can_1") == pytest.approx(1 - 0.05 * abs(np.cos(tilt)) - 0.03 * abs(np.sin(tilt)))


@pytest.mark.parametrize("tilt", [0.0, 0.3, np.pi / 2])
def test_the_lowest_point_of_a_box_is_a_corner(world, tilt):
    put(world, "box_1", [0, 0, 1], [np.cos(tilt / 2), np.sin(tilt / 2), 0, 0])
    assert world.lowest_m("box_1") == pytest.approx(1 - 0.03 * np.cos(tilt) - 0.02 * np.sin(tilt))
    low, high = world.extent("box_1")
    np.testing.assert_allclose([low, high], [[-0.1, -0.02, -0.03], [0.1, 0.02, 0.03]], atol=1e-9)


def test_a_line_down_meets_the_floor_the_wall_or_nothing(world):
    assert world.floor_m("tray_1", np.array([0, 0, 1.0])) == pytest.approx(0.01)
    assert world.floor_m("tray_1", np.array([0.2, 0, 1.0])) == pytest.approx(0.2)
    assert world.floor_m("tray_1", np.array([0.3, 0, 1.0])) is None
    assert world.floor_m("tray_1_region", np.array([0, 0, 1.0])) == pytest.approx(0.01)  # its owner's


def test_things_touch_where_their_shapes_meet(world):
    put(world, "can_1", [0, 0, 0.059])
    assert world.touching("can_1", "tray_1")
    assert world.touching("tray_1_region", "can_1")
    assert world.contacts() == {("can_1", "tray_1"), ("tray_1", "can_1")}
    put(world, "can_1", [0, 0, 0.07])
    assert not world.touching("can_1", "tray_1")


@pytest.mark.parametrize("seed", range(4))
def test_a_gap_is_the_least_distance_also_where_mujoco_says_that_there_is_none(world, seed):
    """Two boxes face to face, whose distance is known however both are turned together."""
    random = np.random.default_rng(seed)
    for _ in range(100):
        gap = random.uniform(0.005, 0.08)
        put(world, "box_1", [0.2 + 0.01 + 0.1 + gap, random.uniform(-0.1, 0.1), random.uniform(0.05, 0.15)])
        assert world.gap_m("box_1", "tray_1", most_m=0.2) == pytest.approx(gap, abs=1e-4)
    put(world, "box_1", [0.2 + 0.01 + 0.1 - 0.001, 0, 0.1])
    assert world.gap_m("box_1", "tray_1") == 0
    put(world, "box_1", [3, 0, 1])
    assert world.gap_m("box_1", "tray_1", most_m=0.2) == 0.2


def test_a_drawer_moves_along_its_slide_and_is_pushed_at_its_front(world):
    np.testing.assert_allclose(world.moves_along("case_1_drawer", np.zeros(3)), [0, 1, 0])
    assert not world.hinged("case_1_drawer")
    local = world.handle("case_1_drawer")
    np.testing.assert_allclose(world.carried("case_1_drawer", local), [0, 0.87, 0], atol=1e-9)
    world.data.joint("slide").qpos[0], world.data.joint("slide").qvel[0] = -0.1, 0.3
    mujoco.mj_forward(world.model, world.data)
    np.testing.assert_allclose(world.carried("case_1_drawer", local), [0, 0.77, 0], atol=1e-9)
    assert world.joints("case_1").tolist() == [-0.1]
    assert world.joint_speeds("case_1_drawer").tolist() == [0.3]


def test_a_door_moves_along_a_circle_around_its_hinge(world):
    assert world.hinged("oven_1")
    np.testing.assert_allclose(world.hinge("oven_1")[:2], [-0.1, 1.88])
    np.testing.assert_allclose(world.moves_along("oven_1", np.array([0.1, 1.88, 0])), [0, 1, 0], atol=1e-9)
    assert world.top_m("oven_1") == pytest.approx(0.1)


def test_what_there_is_not_is_said(world):
    with pytest.raises(UsageError, match="this scene has no 'cup_1'"):
        world.position("cup_1")
    with pytest.raises(UsageError, match="'table_region' is not a thing of this scene"):
        world.solid("table_region")
    with pytest.raises(UsageError, match="'tray_1' has 0 moving parts"):
        world.handle("tray_1")
