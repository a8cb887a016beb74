"""robosuite's control of the arm within a control step, without what it computes anew though it does not change.

Its controller's law, its numbers and their order are robosuite's own (1.4.0), so a trajectory is the same to the last
bit; a test compares them. What is saved is bookkeeping: names looked up, limits gathered, numbers copied, a Jacobian
computed twice, a whole forward pass in each of the 25 substeps, and a record of the last actions and forces that
nothing here reads.
"""

from typing import Any

import numpy as np

_FINGER_WAYS = np.array([-1.0, 1.0])
"""Which way each finger's command goes when the hand closes. `PandaGripper.format_action`."""


class ArmControl:
    """Of one episode: robosuite makes a new controller at each reset.

    What it reads must be up to date in MuJoCo's data: after `mj_step1`, or `mj_forward`.
    """

    def __init__(self, env: Any, model: Any, data: Any) -> None:
        """`model` and `data` are MuJoCo's own, inside of robosuite's wrappers."""
        import mujoco
        from robosuite.utils import control_utils

        self._mujoco: Any = mujoco
        self._law: Any = control_utils
        self._model, self._data = model, data
        (robot,) = env.robots
        self._controller: Any = robot.controller
        self._gripper: Any = robot.gripper
        self._kp_pos, self._kp_ori = np.split(self._controller.kp, 2)
        self._kd_pos, self._kd_ori = np.split(self._controller.kd, 2)
        self._site = model.site(self._controller.eef_name).id
        self._dofs = _span(self._controller.qvel_index)
        self._jac_pos, self._jac_ori = np.zeros((2, 3, model.nv))
        self._mass = np.zeros((model.nv, model.nv))
        # Views of MuJoCo's own memory, which show what the simulation is at.
        self._place, self._turn = data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3)
        self._qvel = data.qvel
        self._joint_pos, self._joint_vel = data.qpos[_span(self._controller.qpos_index)], data.qvel[self._dofs]
        self._gravity = data.qfrc_bias[self._dofs]
        self._torques = data.ctrl[_span(robot._ref_joint_actuator_indexes)]
        self._low, self._high = robot.torque_limits
        fingers = _span([model.actuator(name).id for name in self._gripper.actuators])
        self._fingers = data.ctrl[fingers]
        low, high = model.actuator_ctrlrange[fingers].T
        self._bias, self._weight = 0.5 * (high + low), 0.5 * (high - low)

    def begin(self, action: np.ndarray) -> None:
        """Take a new action (7,), and command the torques and fingers of the first substep. `robot.control`."""
        controller = self._controller
        controller.ee_pos, controller.ee_ori_mat = self._place.copy(), self._turn.copy()
        controller.new_update = False  # all that the goal is set from has been read
        controller.set_goal(action[:6])
        controller.new_update = True
        self._finger_step = _FINGER_WAYS * self._gripper.speed * np.sign(action[6:])
        self.go_on()

    def go_on(self) -> None:
        """Command the torques and fingers of a later substep of the same action. `robot.control`, `grip_action`."""
        np.minimum(np.maximum(self._run(), self._low), self._high, out=self._torques)
        fingers = np.minimum(np.maximum(self._gripper.current_action + self._finger_step, -1.0), 1.0)
        self._gripper.current_action = fingers
        self._fingers[:] = self._bias + self._weight * fingers

    def _run(self) -> np.ndarray:
        """(7,) Nm. `Controller.update`, `OperationalSpaceController.run_controller`."""
        by, law, dofs = self._controller, self._law, self._dofs
        self._mujoco.mj_jacSite(self._model, self._data, self._jac_pos, self._jac_ori, self._site)
        self._mujoco.mj_fullM(self._model, self._mass, self._data.qM)
        # robosuite's matrices lie in columns, and a product of rows would round otherwise.
        mass = self._mass[dofs, dofs].copy("F")
        pos, ori = self._jac_pos[:, dofs].copy("F"), self._jac_ori[:, dofs].copy("F")
        full = np.concatenate((pos, ori))
        _, inertia_pos, inertia_ori, nullspace = law.opspace_matrices(mass, full, pos, ori)
        force = (by.goal_pos - self._place) * self._kp_pos - self._jac_pos.dot(self._qvel) * self._kd_pos
        turn = law.orientation_error(by.goal_ori, self._turn)
        torque = turn * self._kp_ori - self._jac_ori.dot(self._qvel) * self._kd_ori
        wrench = np.concatenate((inertia_pos.dot(force), inertia_ori.dot(torque)))
        posture = law.nullspace_torques(mass, nullspace, by.initial_joint, self._joint_pos, self._joint_vel)
        return full.T.dot(wrench) + self._gravity + posture


def _span(indexes: Any) -> slice:
    """Of the arm's joints or motors, which MuJoCo numbers one after the other: a slice of an array is no copy."""
    return slice(min(indexes), max(indexes) + 1)
