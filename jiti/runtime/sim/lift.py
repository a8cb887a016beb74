"""robosuite's Lift task: a Panda arm, a table, a red cube, two cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from jiti.runtime.sim.engine import global_seed, import_robosuite
from jiti.runtime.sim.gl import Graphics

TASK_ID, INSTRUCTION = "demo/lift", "pick up the cube"
TASK_FILE = Path(__file__).with_name("lift.toml")
"""The task and its constraints, as a file for `--tasks`."""
CAMERAS = ("agentview", "robot0_eye_in_hand")
PICTURE_SIZE = 256
"""Height and width in pixels, LIBERO's in the policies' training sets."""
CONTROL_HZ = 20
"""robosuite's own control rate for its demonstrations."""
ARM_JOINTS = tuple(f"robot0_joint{k}" for k in range(1, 8))
FINGER_JOINTS = ("gripper0_finger_joint1", "gripper0_finger_joint2")
ACTION_NAMES = ("dx", "dy", "dz", "rx", "ry", "rz", "gripper")
"""OSC_POSE: a change of place and of rotation vector, in world axes, and +1 to close the gripper or -1 to open it."""
STEP_M, STEP_RAD = 0.05, 0.5
"""What a 1 in an action means; robosuite 1.4.0, controllers/config/osc_pose.json."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Everything that is recorded of one control step, before its action. World frame, metres, radians."""

    joint_rad: np.ndarray
    """(7,)"""
    joint_rad_s: np.ndarray
    """(7,)"""
    finger_m: np.ndarray
    """(2,): how far each finger stands from the middle, opposite signs."""
    world_T_hand: np.ndarray
    """(4, 4): the point between the fingertips, z pointing out of the hand, y from finger to finger."""
    world_T_cube: np.ndarray
    """(4, 4)"""
    touches_cube: tuple[bool, bool]
    """Whether each finger does."""
    touches_table: bool
    """Whether any part of the gripper does."""
    pictures: Mapping[str, np.ndarray]
    """RGB (256, 256, 3) uint8 by camera; empty without a GL library."""

    @property
    def opening_m(self) -> float:
        """Distance between the fingers."""
        return float(np.abs(self.finger_m).sum())


class LiftScene:
    """The simulation and its cameras.

    A context manager, because a renderer that is still open when Python ends prints errors from its destructor.
    Everything random comes from `seed`: the cube's size, place and turn and the arm's first pose.
    """

    def __init__(self, graphics: Graphics, *, seed: int, cameras: Sequence[str] = CAMERAS) -> None:
        robosuite = import_robosuite(graphics)
        import mujoco

        self._mujoco: Any = mujoco
        self._cameras = tuple(cameras) if graphics.backend else ()
        with global_seed(seed):
            self._env: Any = robosuite.make(
                "Lift",
                robots="Panda",
                controller_configs=robosuite.load_controller_config(default_controller="OSC_POSE"),
                has_renderer=False,
                has_offscreen_renderer=False,
                use_camera_obs=False,
                control_freq=CONTROL_HZ,
                ignore_done=True,
                hard_reset=False,
            )
            self._env.reset()
        self._model, self._data = self._env.sim.model._model, self._env.sim.data._data
        # robosuite hands out its model and data in wrappers; MuJoCo's own renderer wants what is inside.
        self._gripper_geoms = self._geoms(self._env.robots[0].gripper.contact_geoms)
        fingers = self._env.robots[0].gripper.important_geoms
        self._finger_geoms = self._geoms(fingers["left_finger"]), self._geoms(fingers["right_finger"])
        self._cube_geoms = self._geoms(self._env.cube.contact_geoms)
        self._table_geoms = self._geoms(["table_collision"])
        self._renderer: Any = self._open_renderer() if self._cameras else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self._env.close()

    def step(self, action: np.ndarray) -> None:
        """Apply an action (7,) in -1 to 1 for one control step."""
        self._env.step(action)

    def is_lifted(self) -> bool:
        """robosuite's own success: the cube is more than 0.04 m over the table."""
        return bool(self._env._check_success())

    def observe(self) -> Observation:
        hand = self._data.site("gripper0_grip_site")
        cube = self._data.body("cube_main")
        return Observation(
            joint_rad=np.array([self._data.joint(name).qpos[0] for name in ARM_JOINTS]),
            joint_rad_s=np.array([self._data.joint(name).qvel[0] for name in ARM_JOINTS]),
            finger_m=np.array([self._data.joint(name).qpos[0] for name in FINGER_JOINTS]),
            world_T_hand=_transform(hand.xmat, hand.xpos),
            world_T_cube=_transform(cube.xmat, cube.xpos),
            touches_cube=(
                self._touch(self._finger_geoms[0], self._cube_geoms),
                self._touch(self._finger_geoms[1], self._cube_geoms),
            ),
            touches_table=self._touch(self._gripper_geoms, self._table_geoms),
            pictures={camera: self._render(camera) for camera in self._cameras},
        )

    def _geoms(self, names: list[str]) -> frozenset[int]:
        return frozenset(self._model.geom(name).id for name in names)

    def _touch(self, some: frozenset[int], others: frozenset[int]) -> bool:
        pairs = self._data.contact.geom.tolist()
        return any((a in some and b in others) or (b in some and a in others) for a, b in pairs)

    def _open_renderer(self) -> Any:
        renderer = self._mujoco.Renderer(self._model, PICTURE_SIZE, PICTURE_SIZE)
        # Mirrors in the floor and the table take half of the time in software, and show nothing that matters.
        renderer.scene.flags[self._mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        return renderer

    def _render(self, camera: str) -> np.ndarray:
        shown = self._mujoco.MjvOption()
        shown.geomgroup[0] = 0  # robosuite's collision shapes
        self._renderer.update_scene(self._data, camera, shown)
        return self._renderer.render().copy()


def _transform(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(rotation, (3, 3))
    matrix[:3, 3] = place
    return matrix
