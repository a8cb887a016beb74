"""The simulated tasks for lerobot's own evaluation: `--env.type=jiti --env.task=elegant/T2`.

    lerobot-eval --env.discover_packages_path=jiti.runtime.sim.lerobot_env --env.type=jiti --env.task=elegant/T2 ...

A package, because that is what lerobot discovers. Importing it registers the type, and takes seconds for lerobot;
nothing else imports it.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from lerobot.configs.types import FeatureType, PolicyFeature  # noqa: TID253 - this module is lerobot's plugin
from lerobot.envs.configs import EnvConfig  # noqa: TID253

from jiti.runtime.sim.env import ElegantEnv
from jiti.runtime.sim.gl import find_graphics
from jiti.runtime.sim.scene import CONTROL_HZ, PICTURE_SIZE, Start
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.scene_state import scene_state_names

PICTURES = {"front": "image", "wrist": "image2"}
"""lerobot's names of LIBERO's two pictures, by our names of the cameras."""


@EnvConfig.register_subclass("jiti")
@dataclass
class JitiEnv(EnvConfig):
    """Tasks by id, or by the part before the slash for all of a kind, several with commas between."""

    task: str | None = "elegant"
    fps: int = CONTROL_HZ
    assets: str | None = None
    """Asset pack: primitive (the default), libero, or a folder."""
    start: str = "jitter"
    pixels: bool = True
    """Pictures and proprioception, as policies for LIBERO take them; else the poses of everything in their place."""
    observation_size: int = PICTURE_SIZE
    """Height and width of a picture in pixels."""
    episode_length: int | None = None
    """Steps until an episode is cut off; None for 600."""
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        size = (self.observation_size, self.observation_size, 3)
        self.features = {
            "action": PolicyFeature(FeatureType.ACTION, (7,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (8,)),
        }
        self.features_map = {"action": "action", "agent_pos": "observation.state"}
        if self.pixels:
            for name in PICTURES.values():
                self.features[f"pixels/{name}"] = PolicyFeature(FeatureType.VISUAL, size)
                self.features_map[f"pixels/{name}"] = f"observation.images.{name}"
        else:
            self.features["environment_state"] = PolicyFeature(FeatureType.ENV, (len(scene_state_names()),))
            self.features_map["environment_state"] = "observation.environment_state"

    @property
    def task_ids(self) -> list[str]:
        """Ids of the tasks that are meant. Raises CatalogueError for one that there is not."""
        catalogue = load_catalogue()
        simulated = [task.task_id for task in catalogue if task.bddl]
        found: list[str] = []
        for name in (self.task or "elegant").split(","):
            kind = [task_id for task_id in simulated if task_id.partition("/")[0] == name.strip()]
            found += kind or [catalogue.simulated(name.strip()).task_id]
        return list(dict.fromkeys(found))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {
            "assets": self.assets,
            "start": self.start,
            "picture_size": self.observation_size,
            "max_episode_steps": self.episode_length,
        }

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """`{kind: {number: vector environment}}`, a kind being the part of a task's id before the slash."""
        found: dict[str, dict[int, gym.vector.VectorEnv]] = {}
        for task_id in self.task_ids:
            make = partial(LeRobotEnv, task_id, pixels=self.pixels, **self.gym_kwargs)
            kind = found.setdefault(task_id.partition("/")[0], {})
            modes = gym.vector.AutoresetMode
            if use_async_envs and n_envs > 1:
                kind[len(kind)] = gym.vector.AsyncVectorEnv(
                    [make] * n_envs, autoreset_mode=modes.SAME_STEP, context="forkserver"
                )
            else:
                kind[len(kind)] = gym.vector.SyncVectorEnv([make] * n_envs, autoreset_mode=modes.SAME_STEP)
        return found


class LeRobotEnv(gym.Wrapper):
    """One task with lerobot's names; its pictures are mirrored left to right, as in LIBERO's datasets on the Hub.

    What lerobot counts as success is LIBERO's; the sum of rewards of an episode is 1 where it was elegant.
    """

    def __init__(self, task_id: str, *, pixels: bool, start: Start = "jitter", **options: Any) -> None:
        # lerobot-eval makes videos of ten episodes, whatever the policy sees.
        options.setdefault("graphics", find_graphics())
        env = ElegantEnv(task_id, cameras=tuple(PICTURES) if pixels else (), start=start, **options)
        super().__init__(env)
        self._elegant = env
        self._pixels = pixels
        room = dict(env.observation_space.spaces) if isinstance(env.observation_space, spaces.Dict) else {}
        kept = {"agent_pos": room["agent_pos"]}
        if pixels and isinstance(pictures := room["pixels"], spaces.Dict):
            kept["pixels"] = spaces.Dict({PICTURES[camera]: box for camera, box in pictures.items()})
        else:
            kept["environment_state"] = room["environment_state"]
        self.observation_space = spaces.Dict(kept)
        self._max_episode_steps = env.most_steps

    @property
    def task(self) -> str:
        """The task's id."""
        return self._elegant.task.task_id

    @property
    def task_description(self) -> str:
        """The instruction, which lerobot hands to the policy."""
        return self._elegant.task.instruction

    def reset(self, **arguments: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        seen, info = super().reset(**arguments)
        return self._named(seen), info

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        seen, reward, terminated, truncated, info = super().step(action)
        # Vector environments gather numbers; the verdicts by ITC stay with `ElegantEnv`.
        told = {key: value for key, value in info.items() if key in ("is_success", "is_elegant")}
        return self._named(seen), float(reward), terminated, truncated, told

    def render(self) -> np.ndarray:
        return self._elegant.render()

    def _named(self, seen: dict[str, Any]) -> dict[str, Any]:
        named = {"agent_pos": seen["agent_pos"]}
        if self._pixels:
            pictures = seen["pixels"].items()
            named["pixels"] = {PICTURES[camera]: picture[:, ::-1].copy() for camera, picture in pictures}
        else:
            named["environment_state"] = seen["environment_state"]
        return named
