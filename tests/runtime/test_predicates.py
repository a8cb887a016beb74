"""Each predicate on states that are placed by hand, a little on either side of its threshold."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.sim.monitor import Monitor
from jiti.runtime.sim.predicates import LIBEROS, PREDICATES, bind
from jiti.runtime.sim.scene import REST, Scene
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.goal import Atom
from jiti.tasks.rotation import about

pytestmark = pytest.mark.sim
mujoco = pytest.importorskip("mujoco")

CATALOGUE = load_catalogue()
AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}


@pytest.fixture(scope="module")
def scenes() -> Iterator[dict[str, Scene]]:
    """Scenes by task, built when they are first asked for."""

    class Built(dict):
        def __missing__(self, task_id: str) -> Scene:
            self[task_id] = Scene(CATALOGUE.task(task_id))
            self[task_id].reset(0, "file")
            return self[task_id]

    built = Built()
    yield built
    for scene in built.values():
        scene.close()


def place(scene: Scene, name: str, at: np.ndarray, turn: np.ndarray | None = None) -> None:
    """Put an object somewhere, turned in the world by `turn` (3, 3), without a step of time."""
    data = scene.world.data
    address = int(scene.world.model.jnt_qposadr[scene.world.model.body(f"{name}_main").jntadr[0]])
    rotation = scene.world.rotation(name) if turn is None else turn @ scene.world.rotation(name)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    data.qpos[address : address + 3] = at
    data.qpos[address + 3 : address + 7] = quaternion
    mujoco.mj_forward(scene.world.model, data)


@contextmanager
def kept(scene: Scene) -> Iterator[None]:
    """Put everything back afterwards."""
    qpos, qvel = scene.world.data.qpos.copy(), scene.world.data.qvel.copy()
    try:
        yield
    finally:
        scene.world.data.qpos[:], scene.world.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(scene.world.model, scene.world.data)


def settle(scene: Scene, name: str, over: str, height_m: float = 0.01) -> np.ndarray:
    """Let an object fall on the middle of another; gives where it came to rest."""
    top = scene.world.position(over) + [0, 0, height_m]
    place(scene, name, top)
    for _ in range(20):
        scene.step(REST)
    return scene.world.position(name)


@pytest.mark.parametrize(("offset_m", "holds"), [(0.0, True), (0.0095, True), (0.0105, False), (0.025, False)])
@pytest.mark.parametrize("direction_rad", [0.0, 2.0, 4.0])
def test_precisely_on(scenes, offset_m, holds, direction_rad):
    scene = scenes["elegant/T2"]
    with kept(scene):
        predicate = bind(scene, Atom("IsPreciselyOn", ("akita_black_bowl_1", "plate_1")))
        rest = settle(scene, "akita_black_bowl_1", "plate_1", 0.02)
        middle = scene.world.position("plate_1")
        aside = offset_m * np.array([np.cos(direction_rad), np.sin(direction_rad)])
        place(scene, "akita_black_bowl_1", np.array([*(middle[:2] + aside), rest[2] - 0.001]))
        assert predicate.look() == pytest.approx(offset_m, abs=1e-6)
        assert predicate.holds(predicate.look()) is holds


@pytest.mark.parametrize(("tilt_rad", "holds"), [(0.09, True), (0.11, False)])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_precisely_on_asks_for_a_level_object(scenes, tilt_rad, holds, axis):
    scene = scenes["elegant/T2"]
    with kept(scene):
        predicate = bind(scene, Atom("IsPreciselyOn", ("akita_black_bowl_1", "plate_1")))
        rest = settle(scene, "akita_black_bowl_1", "plate_1", 0.02)
        middle = scene.world.position("plate_1")
        place(scene, "akita_black_bowl_1", np.array([*middle[:2], rest[2]]), about(AXES[axis], tilt_rad))
        assert predicate.holds(predicate.look()) is holds


def test_precisely_on_asks_for_contact_and_takes_a_tolerance_of_the_goal(scenes):
    scene = scenes["elegant/T2"]
    with kept(scene):
        strict = bind(scene, Atom("IsPreciselyOn", ("akita_black_bowl_1", "plate_1")))
        loose = bind(scene, Atom("IsPreciselyOn", ("akita_black_bowl_1", "plate_1"), 0.02))
        rest = settle(scene, "akita_black_bowl_1", "plate_1", 0.02)
        place(scene, "akita_black_bowl_1", rest + [0.015, 0, -0.001])
        assert not strict.holds(strict.look())
        assert loose.holds(loose.look())
        place(scene, "akita_black_bowl_1", rest + [0, 0, 0.01])
        assert strict.look() == np.inf


@pytest.mark.parametrize(("clearance_m", "holds"), [(0.0, True), (0.019, True), (0.021, False), (0.1, False)])
def test_on_bottom_of(scenes, clearance_m, holds):
    scene = scenes["elegant/T0"]
    with kept(scene):
        world = scene.world
        predicate = bind(scene, Atom("IsOnBottomOf", ("ketchup_1", "basket_1")))
        middle = world.position("basket_1")
        place(scene, "ketchup_1", middle + [0, 0, 0.2])
        floor = world.floor_m("basket_1", middle + [0, 0, 0.1])
        assert floor is not None
        drop = world.lowest_m("ketchup_1") - floor - clearance_m
        place(scene, "ketchup_1", middle + [0, 0, 0.2 - drop])
        assert predicate.look() == pytest.approx(clearance_m, abs=1e-6)
        assert predicate.holds(predicate.look()) is holds
        place(scene, "ketchup_1", middle + [0.3, 0, 0.2])
        assert predicate.look() == np.inf


@pytest.mark.parametrize(("angle_rad", "holds"), [(0.0, True), (0.095, True), (0.105, False), (0.6, False)])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_orientation_aligned(scenes, angle_rad, holds, axis):
    scene = scenes["elegant/T4"]
    with kept(scene):
        region = "desk_caddy_1_back_contain_region"
        predicate = bind(scene, Atom("IsOrientationAligned", ("black_book_1", region)))
        for quarter in (0, 1, 2):  # whichever axis to whichever
            square = scene.world.rotation(region) @ about([0, 0, 1], quarter * np.pi / 2)
            turn = about(AXES[axis], angle_rad) @ square @ scene.world.rotation("black_book_1").T
            place(scene, "black_book_1", scene.world.position(region) + [0, 0, 0.3], turn)
            assert predicate.look() == pytest.approx(angle_rad, abs=1e-5)
            assert predicate.holds(predicate.look()) is holds


@pytest.mark.parametrize(
    ("shift_m", "turn_rad", "holds"),
    [(0.0, 0.0, True), (0.0049, 0.0, True), (0.0051, 0.0, False), (0.0, 0.099, True), (0.0, 0.101, False)]
    + [(0.0024, 0.05, True), (0.0026, 0.05, False)],
)
def test_position_unchanged(scenes, shift_m, turn_rad, holds):
    scene = scenes["elegant/T7"]
    with kept(scene):
        predicate = bind(scene, Atom("PositionUnchanged", ("yellow_book_1",)))
        at = scene.world.position("yellow_book_1")
        place(scene, "yellow_book_1", at + [0, shift_m, 0], about([0, 0, 1], turn_rad))
        assert predicate.holds(predicate.look()) is holds
        predicate.begin()  # a new episode begins where things are then
        assert predicate.holds(predicate.look())


@pytest.mark.parametrize(("aside_m", "fingers"), [(0.0, 2), (0.006, 1), (0.2, 0)])
def test_grasping_takes_both_fingers(scenes, aside_m, fingers):
    scene = scenes["elegant/T2"]
    with kept(scene):
        world, name = scene.world, "cream_cheese_1"
        predicate = bind(scene, Atom("IsGrasping", (name,)))
        hand = scene.world_T_eef
        # Its thinnest side, 18 mm, between pads that are pressed a millimetre into it.
        box = np.column_stack([hand[:3, 2], -hand[:3, 0], hand[:3, 1]])
        box[:, 1] *= np.sign(np.linalg.det(box))
        half = (world.extent(name)[1] - world.extent(name)[0])[2] / 2
        for joint, sign in (("gripper0_finger_joint1", 1), ("gripper0_finger_joint2", -1)):
            world.data.joint(joint).qpos[0] = sign * (half - 0.001)
        place(scene, name, hand[:3, 3] + aside_m * hand[:3, 1], box @ world.rotation(name).T)
        assert 2 - predicate.look() == fingers
        assert predicate.holds(predicate.look()) is (fingers == 2)


@pytest.mark.parametrize("task_id", ["g4/close-top-drawer", "g4/close-microwave"])
def test_moves_gently(scenes, task_id):
    scene = scenes[task_id]
    (itc,) = scene.task.itcs
    name = "microwave_1" if "microwave" in task_id else "wooden_cabinet_1_top_region"
    atom = next(a for a in Monitor(scene).predicates if a.startswith("MovesGently"))
    assert name in atom
    assert name in itc.goal
    with kept(scene):
        words = atom.split()
        tolerance = float(words[2]) if len(words) > 2 else None
        predicate = bind(scene, Atom("MovesGently", (name,), tolerance))
        limit = tolerance or PREDICATES["MovesGently"].default
        body = scene.world.model.joint(scene.world._joints_of(name)[0])
        for speed, holds in ((0.0, True), (0.98 * limit, True), (-0.98 * limit, True), (1.02 * limit, False)):
            scene.world.data.qvel[body.dofadr[0]] = speed
            assert predicate.look() == pytest.approx(abs(speed))
            assert predicate.holds(predicate.look()) is holds


def test_liberos_predicates_are_watched_as_they_are(scenes):
    scene = scenes["elegant/T2"]
    with kept(scene):
        on = bind(scene, Atom("On", ("akita_black_bowl_1", "plate_1")))
        assert not on.holds(on.look())
        settle(scene, "akita_black_bowl_1", "plate_1", 0.02)
        assert on.holds(on.look())
        assert scene.succeeded()


@pytest.mark.parametrize(
    ("atom", "said"),
    [
        (Atom("IsGraspin", ("plate_1",)), "there is no predicate 'IsGraspin'; did you mean 'IsGrasping'"),
        (Atom("IsGrasping", ("plate_1", "bowl")), "IsGrasping takes 1 things and got 2"),
        (Atom("IsGrasping", ("cup_1",)), "this scene has no 'cup_1'"),
        (Atom("On", ("cup_1", "plate_1")), "this scene has no 'cup_1'"),
        (Atom("On", ("plate_1", "plate_1"), 0.1), "takes no tolerance"),
    ],
)
def test_a_wrong_predicate_is_refused(scenes, atom, said):
    with pytest.raises(UsageError, match=said):
        bind(scenes["elegant/T2"], atom)


def test_every_predicate_says_what_it_measures_and_why():
    for predicate in PREDICATES.values():
        words = predicate.__doc__ or ""
        assert "Geometry:" in words
        assert "holds" in words
    assert len(PREDICATES) == 6
    assert not set(PREDICATES) & set(LIBEROS)
