"""Gymnasium environments of the simulated tasks, with the ITCs in what they tell of an episode.

Importing this module registers them by task id.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from jiti.errors import UsageError
from jiti.runtime.sim.gl import Graphics, find_graphics
from jiti.runtime.sim.monitor import Monitor
from jiti.runtime.sim.proprio import proprio, scene_order, scene_vector
from jiti.runtime.sim.scene import CONTROL_HZ, PICTURE_SIZE, Scene, Start
from jiti.runtime.sim.world import GRIPPER
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.scene_state import scene_state_names
from jiti.tasks.task import Task

MOST_STEPS = 600
"""Steps after which an episode is cut off. Our choice: the longest demonstration, a push in T6, takes 480; lerobot
0.6.1 cuts LIBERO's suites off after 280 to 520, before some ITCs are decided."""
SETTLED_STEPS = 10
"""Steps without a touch, after a success, that end an episode. Our choice: half a second, in which what was let go of
comes to rest; ending at the first success, as lerobot does, would end before the hand lets go."""


class ElegantEnv(gym.Env):
    """One task. Actions: LIBERO's 7-D OSC_POSE, -1 to 1.

    Observations are a dict: `agent_pos` (8,) float32, the proprioception that lerobot's LIBERO environment gives;
    `environment_state` (n,) float32, where things are, the same numbers for every task (`jiti.tasks.scene_state`),
    named by `environment_state_names`; and with cameras `pixels`, a dict of RGB (size, size, 3) uint8, upright, by
    camera.

    The reward is 1 at the step that ends an episode elegantly and 0 everywhere else, so that its sum is the ESR. `info`
    has `is_success` (whether LIBERO's predicate has held) at each step, and at the last `is_elegant` and `itcs`, by id.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012 - Gymnasium's own form

    def __init__(
        self,
        task: str | Task,
        *,
        cameras: Sequence[str] = (),
        assets: Path | str | None = None,
        start: Start = "jitter",
        picture_size: int = PICTURE_SIZE,
        max_episode_steps: int | None = None,
        graphics: Graphics | None = None,
        render_mode: str = "rgb_array",
    ) -> None:
        """Raises CatalogueError for an unknown task, UsageError when there is no GL library for the pictures."""
        self.task = task if isinstance(task, Task) else load_catalogue().simulated(task)
        graphics = graphics or (find_graphics() if cameras else Graphics(None, "no pictures were asked for"))
        if cameras and graphics.backend is None:
            raise UsageError(f"{self.task.task_id} with cameras {', '.join(cameras)}: {graphics.message}")
        self.render_mode = render_mode
        self._start: Start = start
        self.most_steps = max_episode_steps or MOST_STEPS
        self.scene = Scene(self.task, assets=assets, graphics=graphics, cameras=cameras, picture_size=picture_size)
        self._graphics = graphics
        self.monitor = Monitor(self.scene)
        self.environment_state_names = scene_state_names()
        self._order = scene_order(self.scene)
        room: dict[str, spaces.Space] = {
            "agent_pos": spaces.Box(-np.inf, np.inf, (8,), np.float32),
            "environment_state": spaces.Box(-np.inf, np.inf, (len(self.environment_state_names),), np.float32),
        }
        if self.scene.cameras:
            shape = (picture_size, picture_size, 3)
            room["pixels"] = spaces.Dict({c: spaces.Box(0, 255, shape, np.uint8) for c in self.scene.cameras})
        self.observation_space = spaces.Dict(room)
        self.action_space = spaces.Box(-1, 1, (7,), np.float32)

    @property
    def task_description(self) -> str:
        """The instruction; lerobot hands it to the policy under this name."""
        return self.task.instruction

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """The same seed gives the same episode; without one, it is drawn. `options["start"]` overrides the start."""
        super().reset(seed=seed)
        seed = int(self.np_random.integers(1 << 31)) if seed is None else seed
        self.scene.reset(seed, (options or {}).get("start", self._start))
        self.monitor.begin()
        self._steps = self._settled = 0
        return self.observe(), {"is_success": False, "seed": seed}

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Raises UsageError for an action of another shape."""
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (7,):
            raise UsageError(f"an action has 7 numbers and this one has the shape {action.shape}")
        self.scene.step(np.clip(action, -1, 1))
        self.monitor.look()
        self._steps += 1
        success = self.monitor.success
        self._settled = self._settled + 1 if success and not self._touched() else 0
        terminated = self._settled >= SETTLED_STEPS
        truncated = not terminated and self._steps >= self.most_steps
        info: dict[str, Any] = {"is_success": success}
        reward = 0.0
        if terminated or truncated:
            outcome = self.monitor.outcome()
            reward = float(outcome.elegant)
            info |= {"is_elegant": outcome.elegant, "itcs": outcome.to_json()["itcs"]}
        return self.observe(), reward, terminated, truncated, info

    def render(self) -> np.ndarray:
        """The front camera's view. Raises UsageError without a GL library."""
        if self._graphics.backend is None:
            here = find_graphics().message
            raise UsageError(f"make the environment with cameras=('front',) to render. Here: {here}")
        return self.scene.render("front")

    def close(self) -> None:
        self.scene.close()

    def observe(self) -> dict[str, Any]:
        """The observation of the state as it is; `reset` and `step` give it as well."""
        seen: dict[str, Any] = {
            "agent_pos": proprio(self.scene),
            "environment_state": scene_vector(self.scene, self._order),
        }
        if self.scene.cameras:
            seen["pixels"] = {camera: self.scene.render(camera) for camera in self.scene.cameras}
        return seen

    def _touched(self) -> bool:
        things = [n for n in self.scene.interest if n not in self.scene.world.names.regions]
        return any(GRIPPER in pair for pair in self.scene.world.contacts((*things, GRIPPER)))


def _register_all() -> None:
    """Every simulated task of the package, under its id: `gymnasium.make("jiti.runtime.sim.env:elegant/T2")`."""
    for task in load_catalogue():
        if task.bddl and task.task_id not in gym.registry:
            gym.register(task.task_id, entry_point=f"{__name__}:ElegantEnv", kwargs={"task": task.task_id})


_register_all()
