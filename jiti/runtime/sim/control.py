"""robosuite's control of the arm within a control step, without what it computes anew though it does not change.

Its controller's law, its numbers and their order are robosuite's own (1.4.0), so a trajectory is the same to the last
bit; a test compares them. What is saved is bookkeeping: names looked up, limits gathered, a Jacobian computed twice
and a whole forward pass, in each of the 25 substeps. It was a third of all the time that a simulation took.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np


class ArmControl:
    """Of one episode: robosuite makes a new controller at each reset.

    What it reads must be up to date in MuJoCo's data: after `mj_step1`, or `mj_forward`.
    """

    def __init__(self, env: Any, model: Any, data: Any) -> None:
        """`model` and `data` are MuJoCo's own, inside of robosuite's wrappers."""
        import mujoco

        self._mujoco: Any = mujoco
        self._env, self._model, self._data = env, model, data
        (self._robot,) = env.robots
        self._controller: Any = self._robot.controller
        self._site = model.site(self._controller.eef_name).id
        self._qpos = np.asarray(self._controller.qpos_index)
        self._qvel = np.asarray(self._controller.qvel_index)
        self._torques = np.asarray(self._robot._ref_joint_actuator_indexes)
        self._low, self._high = self._robot.torque_limits
        gripper: Any = self._robot.gripper
        self._fingers = np.array([model.actuator(name).id for name in gripper.actuators])
        low, high = model.actuator_ctrlrange[self._fingers].T
        self._bias, self._weight = 0.5 * (high + low), 0.5 * (high - low)
        self._jac_pos, self._jac_ori = np.zeros((2, 3, model.nv))
        self._mass = np.zeros((model.nv, model.nv))

    @contextmanager
    def acting(self) -> Iterator[None]:
        """Let the controller read the arm's state by `_read` meanwhile."""
        self._controller.update = self._read
        try:
            yield
        finally:
            del self._controller.update

    def begin(self, action: np.ndarray) -> None:
        """Take a new action (7,), and command the torques and fingers of the first substep. `robot.control`."""
        self._env._pre_action(action, policy_step=True)

    def go_on(self, action: np.ndarray) -> None:
        """Command the torques and fingers of a later substep of the same action. `robot.control`, `grip_action`."""
        robot, ctrl = self._robot, self._data.ctrl
        robot.torques = np.clip(self._controller.run_controller(), self._low, self._high)
        ctrl[self._fingers] = self._bias + self._weight * robot.gripper.format_action(action[6:])
        ctrl[self._torques] = robot.torques

    def _read(self, force: bool = False) -> None:
        """`Controller.update`."""
        to, data = self._controller, self._data
        if not (to.new_update or force):
            return
        to.ee_pos = data.site_xpos[self._site].copy()
        to.ee_ori_mat = data.site_xmat[self._site].reshape(3, 3).copy()
        self._mujoco.mj_jacSite(self._model, data, self._jac_pos, self._jac_ori, self._site)
        to.ee_pos_vel, to.ee_ori_vel = self._jac_pos @ data.qvel, self._jac_ori @ data.qvel
        to.joint_pos, to.joint_vel = data.qpos[self._qpos], data.qvel[self._qvel]
        # The order in memory of what indexing gives is not that of rows, which the controller's compiled code expects.
        to.J_pos = np.array(self._jac_pos[:, self._qvel])
        to.J_ori = np.array(self._jac_ori[:, self._qvel])
        to.J_full = np.concatenate([to.J_pos, to.J_ori])
        self._mujoco.mj_fullM(self._model, self._mass, data.qM)
        to.mass_matrix = self._mass[self._qvel, :][:, self._qvel]
        to.new_update = False
