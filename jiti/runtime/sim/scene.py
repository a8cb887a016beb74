"""One of LIBERO's tasks in MuJoCo: reset from a seed, stepped by actions, looked at by name and by camera."""

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, get_args
from xml.etree.ElementTree import ParseError

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.sim.control import ArmControl
from jiti.runtime.sim.engine import global_seed
from jiti.runtime.sim.gl import Graphics
from jiti.runtime.sim.libero import bddl_file, has_initial_states, import_libero, initial_states
from jiti.runtime.sim.start import jitter
from jiti.runtime.sim.world import Names, World
from jiti.tasks.task import Task

Start = Literal["jitter", "file", "sampled"]
"""How an episode begins: from one of LIBERO's own initial states with every object moved and turned a little, from one
of them as it is, or from places drawn in the regions of the BDDL file."""

CONTROL_HZ = 20
"""LIBERO's control rate."""
SUBSTEPS = 25
"""Steps of MuJoCo in one of control: robosuite simulates at 500 Hz."""
SETTLE_STEPS = 10
"""Steps of rest after a reset, until what was placed has come to lie. lerobot 0.6.1, `LiberoEnv.num_steps_wait`."""
MOST_SETTLE_STEPS, STILL_M_S = 60, 0.01
"""Where something still moves faster then, rest goes on for so many steps. Our choice: LIBERO's own states of T1 begin
with a bottle inside the table, which throws it half a metre up; it has landed after about 30."""
REST = np.array([0, 0, 0, 0, 0, 0, -1.0])
"""The action that holds the arm still with an open hand."""
CAMERAS = {"front": "agentview", "wrist": "robot0_eye_in_hand"}
"""Our names of LIBERO's two cameras."""
PICTURE_SIZE = 256
"""Height and width in pixels, as in the policies' training sets."""
ARM_JOINTS = tuple(f"robot0_joint{k}" for k in range(1, 8))
FINGER_JOINTS = ("gripper0_finger_joint1", "gripper0_finger_joint2")
ACTION_NAMES = ("dx", "dy", "dz", "rx", "ry", "rz", "gripper")
"""OSC_POSE: a change of place and of rotation vector, in world axes, and +1 to close the gripper or -1 to open it."""
STEP_M, STEP_RAD = 0.05, 0.5
"""What a 1 in an action means; robosuite 1.4.0, controllers/config/osc_pose.json."""
_DRAWS = 50
"""Times that robosuite may fail to place objects at random before the seed is given up. Our choice."""


class Scene:
    """A context manager, because a renderer that is still open when Python ends prints errors from its destructor.

    One scene serves many episodes: a reset depends on its arguments alone, not on what happened before.
    """

    world: World

    def __init__(
        self,
        task: Task,
        *,
        assets: Path | str | None = None,
        graphics: Graphics | None = None,
        cameras: Sequence[str] = (),
        picture_size: int = PICTURE_SIZE,
    ) -> None:
        """Raises UsageError when the task is not one of simulation or something that it needs is not there.

        `cameras` are keys of `CAMERAS`; without a GL library in `graphics` there are none.
        """
        if task.bddl is None:
            raise UsageError(
                f"the task {task.task_id} has no BDDL file, so it cannot be simulated; `jiti tasks` lists all"
            )
        envs = import_libero(assets, graphics)
        import mujoco
        import robosuite

        self._mujoco: Any = mujoco
        self.task = task
        self._file = bddl_file(task.bddl)
        self._size = picture_size
        self.cameras = tuple(cameras) if graphics and graphics.backend else ()
        info = importlib.import_module("libero.libero.envs.bddl_utils").get_problem_info(str(self._file))
        problem = envs.TASK_MAPPING[info["problem_name"]]
        with global_seed(0), _explained(task, assets):
            self._env: Any = problem(
                str(self._file),
                robots=["Panda"],
                controller_configs=robosuite.load_controller_config(default_controller="OSC_POSE"),
                initialization_noise=None,
                use_camera_obs=False,
                has_renderer=False,
                has_offscreen_renderer=False,
                control_freq=CONTROL_HZ,
                ignore_done=True,
                hard_reset=False,
            )
            # They are computed in every one of 25 substeps, and all they tell is read from MuJoCo where it is wanted.
            self._env._observables = {}
            self._reset_env()
        self._renderer: Any = None
        self._starts: np.ndarray | None = None

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

    def reset(self, seed: int, start: Start = "jitter") -> None:
        """Begin an episode: the same seed and start always give the same one. Raises UsageError for another start.

        Of LIBERO's files, seed k takes state k modulo their number; a task without a file is sampled.
        """
        if start not in get_args(Start):
            raise UsageError(f"{start!r} is no start; there are: {', '.join(get_args(Start))}")
        if not has_initial_states(self.task.bddl or ""):
            start = "sampled"
        random = np.random.default_rng([seed, 0])
        with global_seed(int(random.integers(1 << 32))):
            self._reset_env()
        if start != "sampled":
            self._set_state(self._file_state(seed))
        if start == "jitter":
            jitter(self.world, random)
        self._rest_controller()
        for count in range(MOST_SETTLE_STEPS):
            if count >= SETTLE_STEPS and self.world.fastest_m_s() < STILL_M_S:
                break
            self.step(REST)

    def step(self, action: np.ndarray) -> None:
        """Apply an action (7,) in -1 to 1 for one control step of 1/20 s.

        To the last bit what robosuite's own `env.step` does, in a third of its time: that computes positions and
        forces of the same state three times in each of the 25 substeps, once for itself, once for the controller and
        once to integrate. Here the controller acts between the two halves of MuJoCo's step.
        """
        model, data = self.world.model, self.world.data
        action = np.asarray(action, dtype=np.float64)
        for substep in range(SUBSTEPS):
            self._mujoco.mj_step1(model, data)
            if substep == 0:
                self._control.begin(action)
            else:
                self._control.go_on()
            self._mujoco.mj_step2(model, data)
        self._env._post_process()

    @property
    def interest(self) -> tuple[str, ...]:
        """Objects, fixtures and regions that the task is about, as the BDDL file lists them."""
        known = {*self.world.names.objects, *self.world.names.fixtures, *self.world.names.regions}
        return tuple(n for n in self._env.obj_of_interest if n in known)

    @property
    def goal(self) -> tuple[tuple[str, ...], ...]:
        """What LIBERO's success predicate asks for, as the BDDL file lists it: `("in", "black_book_1", region)`."""
        return tuple(tuple(atom) for atom in self._env.parsed_problem["goal_state"])

    def succeeded(self) -> bool:
        """LIBERO's own success predicate, as it is."""
        return bool(self._env._check_success())

    def holds(self, name: str, *arguments: str) -> bool:
        """One of LIBERO's own predicates (`In`, `On`, `Close`, `Turnon`, ...) at this moment. Raises UsageError."""
        missing = [a for a in arguments if a not in self._env.object_states_dict]
        if missing:
            raise UsageError(f"this scene has no {missing[0]!r}; it has: {', '.join(self._env.object_states_dict)}")
        return bool(self._env._eval_predicate([name.lower(), *arguments]))

    @property
    def world_T_eef(self) -> np.ndarray:
        """(4, 4): the point between the fingertips, with the hand's axes: z out of it, y from finger to finger."""
        pose = np.eye(4)
        pose[:3, :3] = self.world.data.body("robot0_right_hand").xmat.reshape(3, 3)
        pose[:3, 3] = self.world.data.site("gripper0_grip_site").xpos
        return pose

    @property
    def eef_quaternion_xyzw(self) -> np.ndarray:
        """(4,): rotation of the hand in the world, with MuJoCo's sign, which does not jump while the arm moves."""
        return self.world.data.body("robot0_right_hand").xquat[[1, 2, 3, 0]]

    @property
    def joint_rad(self) -> np.ndarray:
        """(7,)"""
        return np.array([self.world.data.joint(name).qpos[0] for name in ARM_JOINTS])

    @property
    def joint_rad_s(self) -> np.ndarray:
        """(7,)"""
        return np.array([self.world.data.joint(name).qvel[0] for name in ARM_JOINTS])

    @property
    def finger_m(self) -> np.ndarray:
        """(2,): how far each finger stands from the middle, with opposite signs."""
        return np.array([self.world.data.joint(name).qpos[0] for name in FINGER_JOINTS])

    def render(self, camera: str, *, size: int | None = None) -> np.ndarray:
        """RGB (size, size, 3) uint8, upright, from one of `CAMERAS` or any camera of the scene."""
        size = size or self._size
        if self._renderer is not None and self._renderer.width != size:
            self._renderer.close()
            self._renderer = None
        if self._renderer is None:
            self._renderer = self._mujoco.Renderer(self.world.model, size, size)
            # Mirrors in the floor and the table take half of the time in software, and show nothing that matters.
            self._renderer.scene.flags[self._mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        shown = self._mujoco.MjvOption()
        shown.geomgroup[0] = 0  # robosuite's collision shapes
        self._renderer.update_scene(self.world.data, CAMERAS.get(camera, camera), shown)
        return self._renderer.render().copy()

    def _reset_env(self) -> None:
        from robosuite.utils.errors import RandomizationError

        for _ in range(_DRAWS):
            try:
                self._env.reset()
                break
            except RandomizationError:
                continue
        else:
            raise UsageError(f"the objects of {self.task.task_id} found no place in {_DRAWS} draws; take another seed")
        # robosuite hands out its model and data in wrappers; MuJoCo's own functions want what is inside.
        model, data = self._env.sim.model._model, self._env.sim.data._data
        if not hasattr(self, "world"):
            self.world = World(model, data, self._names())
        self._control = ArmControl(self._env, model, data)
        # A soft reset leaves the fingers' last command where it was.
        self._env.robots[0].gripper.current_action = np.zeros(self._env.robots[0].gripper.dof)

    def _names(self) -> Names:
        sites = self._env.object_sites_dict
        regions = {name: getattr(site, "parent_name", None) for name, site in sites.items()}
        fixtures = [n for n in self._env.fixtures_dict if n in self._env.object_states_dict]
        return Names(tuple(self._env.objects_dict), tuple(fixtures), regions)

    def _file_state(self, seed: int) -> np.ndarray:
        if self._starts is None:
            self._starts = initial_states(self.task.bddl or "")
        state = self._starts[seed % len(self._starts)]
        model = self.world.model
        if len(state) != 1 + model.nq + model.nv:
            raise UsageError(
                f"LIBERO's initial states of {self.task.task_id} have {len(state)} numbers and the scene takes "
                f"{1 + model.nq + model.nv}: the asset pack has other joints than LIBERO's. `jiti tasks check` tells."
            )
        return state

    def _set_state(self, state: np.ndarray) -> None:
        model, data = self.world.model, self.world.data
        data.time = 0.0
        data.qpos[:] = state[1 : 1 + model.nq]
        data.qvel[:] = state[1 + model.nq :]
        self._mujoco.mj_forward(model, data)

    def _rest_controller(self) -> None:
        """Let the arm's controller hold the pose that the arm has now."""
        self._mujoco.mj_forward(self.world.model, self.world.data)
        controller = self._env.robots[0].controller
        controller.update(force=True)
        controller.update_initial_joints(self.joint_rad)
        controller.reset_goal()


@contextmanager
def _explained(task: Task, assets: Path | str | None) -> Iterator[None]:
    """What LIBERO says when an asset pack of a user's lacks something; ours does not."""
    try:
        yield
    except (OSError, ParseError, ValueError, AttributeError, KeyError, TypeError) as error:
        if assets in (None, "primitive"):
            raise
        raise UsageError(
            f"the asset pack {assets} does not build {task.task_id}: {error}. `jiti tasks check --assets {assets}` "
            "says what it lacks."
        ) from error
