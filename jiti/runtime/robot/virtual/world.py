"""The arm, its servos and the things on its table, as physics moves them.

Whoever looks at the world or touches it from another thread holds `lock`. It moves only when told: `step` by hand,
which is the same every time, or `advance` by a clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from threading import RLock

import numpy as np

from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.hand import Hand, Path
from jiti.runtime.robot.virtual.scenes import SCENES, engine, lay_out, load
from jiti.runtime.robot.virtual.servo import DRAG, Servo

MOUNTS = {
    "shoulder_pan": 37,
    "shoulder_lift": -214,
    "elbow_flex": 512,
    "wrist_flex": -90,
    "wrist_roll": 1300,
    "gripper": -777,
}
"""The six joints from the table up, which have ids 1 to 6, each with its servo's mount. Our choice: no two alike."""
FULL_TURN = "wrist_roll"
"""The joint that lerobot's calibration takes for one that turns all the way round."""
REST_RAD = {"shoulder_lift": -1.745, "elbow_flex": 1.69, "wrist_flex": 0.6}
"""Folded over its base, as people leave it; the other joints are at 0. Our choice."""
CONTROL_S = 0.005
"""Between two decisions of a servo. Our choice: finer than any motion that it can make."""
LONGEST_S = 0.25
"""Most that `advance` makes up for. When no one came for longer, the world stood still. Our choice."""
AT_ONCE = 4
"""Most steps of one `advance`, a millisecond of work, so that packets are not kept waiting. Our choice."""
JAMMED = 1e4
"""Drag of a joint that does not move, in N m s/rad."""


@dataclass(frozen=True, slots=True)
class State:
    """Where everything is at one moment."""

    time_s: float
    """Since the world began."""
    joints: Mapping[str, float]
    """Angles in radians."""
    objects: Mapping[str, np.ndarray]
    """`world_T_object` (4, 4) of everything that the task is about, in metres; z points up from the table's top."""
    drawers: Mapping[str, float]
    """How far each stands open, in metres."""


@dataclass(frozen=True, slots=True)
class Pose:
    """The same as MuJoCo has it, for a picture."""

    qpos: np.ndarray
    mocap_pos: np.ndarray
    mocap_quat: np.ndarray


class World:
    """One task's scene with the arm at rest in it, its torque off."""

    def __init__(self, task_id: str, *, seed: int = 0, faults: Faults | None = None) -> None:
        """Raises UsageError for a task without a scene, or where MuJoCo is not installed."""
        self._mujoco = engine()
        self.lock = RLock()
        self.faults = faults or Faults()
        self.task_id = task_id
        self.model = load(task_id)
        self.data = self._mujoco.MjData(self.model)
        self._substeps = round(CONTROL_S / self.model.opt.timestep)
        self._qpos, self._dof, self.servos = [], [], {}
        for number, (name, mount) in enumerate(MOUNTS.items(), start=1):
            joint = self.model.joint(name)
            self._qpos.append(joint.qposadr[0])
            self._dof.append(joint.dofadr[0])
            self.data.qpos[joint.qposadr[0]] = REST_RAD.get(name, 0.0)
            low, high = joint.range
            self.servos[number] = Servo(number, low_rad=low, high_rad=high, mount=mount, full_turn=name == FULL_TURN)
        self.reset(seed)
        for servo, place in zip(self.servos.values(), self._qpos, strict=True):
            servo.power_up(self.data.qpos[place])
        self._until: float | None = None
        self._hand: Hand | None = None

    def reset(self, seed: int) -> None:
        """Lay the things out anew; the arm stays as it is."""
        with self.lock:
            lay_out(self.task_id, self.model, self.data, seed)
            self._mujoco.mj_forward(self.model, self.data)

    def lead(self, path: Path) -> None:
        """Have a hand move the arm along a path from now on, and hold it at the end."""
        with self.lock:
            self._hand = Hand(path, self.data.time)

    def led(self) -> bool:
        """Whether a hand has come to the end of its path."""
        with self.lock:
            return self._hand is not None and self._hand.at_end(self.data.time)

    def step(self, times: int = 1) -> None:
        """Let CONTROL_S pass, once or more."""
        with self.lock:
            for _ in range(times):
                self._control()
                self._mujoco.mj_step(self.model, self.data, nstep=self._substeps)
                self._measure()

    def advance(self, now_s: float) -> bool:
        """Let the world follow a clock, of which only the differences matter; whether it is still behind."""
        with self.lock:
            if self._until is None or now_s - self._until > LONGEST_S:
                self._until = now_s
            behind = int((now_s - self._until) / CONTROL_S)
            times = min(behind, AT_ONCE)
            self._until += times * CONTROL_S
            self.step(times)
            return behind > times

    def state(self) -> State:
        with self.lock:
            angles = dict(zip(MOUNTS, self.data.qpos[self._qpos].tolist(), strict=True))
            objects = {name: self._pose(name) for name in SCENES.get(self.task_id, {})}
            slides = [k for k in range(self.model.njnt) if self.model.jnt_type[k] == self._mujoco.mjtJoint.mjJNT_SLIDE]
            drawers = {self.model.joint(k).name: float(self.data.joint(k).qpos[0]) for k in slides}
            return State(self.data.time, angles, objects, drawers)

    def pose(self) -> Pose:
        with self.lock:
            return Pose(self.data.qpos.copy(), self.data.mocap_pos.copy(), self.data.mocap_quat.copy())

    def _pose(self, name: str) -> np.ndarray:
        body, pose = self.data.body(name), np.eye(4)
        pose[:3, :3], pose[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return pose

    def _control(self) -> None:
        model, data = self.model, self.data
        angles = data.qpos[self._qpos].tolist()
        for k, (number, servo) in enumerate(self.servos.items()):
            drive = servo.drive(angles[k], CONTROL_S)
            data.ctrl[k] = drive.target_rad
            model.actuator_gainprm[k, 0] = drive.stiffness
            model.actuator_biasprm[k, 1:3] = -drive.stiffness, -drive.damping
            model.actuator_forcerange[k] = -drive.limit_nm, drive.limit_nm
            model.dof_damping[self._dof[k]] = JAMMED if number in self.faults.jam else DRAG
        if self._hand is not None:
            torques = self._hand.torques(data.qpos[self._qpos], data.qvel[self._dof], data.time)
            data.qfrc_applied[self._dof] = torques

    def _measure(self) -> None:
        angles, speeds = self.data.qpos[self._qpos].tolist(), self.data.qvel[self._dof].tolist()
        torques = self.data.actuator_force.tolist()
        for k, (number, servo) in enumerate(self.servos.items()):
            weak = number in self.faults.overload
            servo.measure(angles[k], speeds[k], torques[k], CONTROL_S, weak=weak)
