"""Draws a world as its cameras see it. A painter belongs to one thread, as GL contexts do."""

from typing import Any

import numpy as np

from jiti.runtime.robot.virtual.scenes import engine, load
from jiti.runtime.robot.virtual.world import Pose

CAMERAS = ("front", "wrist")


class Painter:
    def __init__(self, task_id: str) -> None:
        self._engine = engine()
        self._model = load(task_id)
        self._data = self._engine.MjData(self._model)
        self._renderers: dict[tuple[int, int], Any] = {}

    def paint(self, pose: Pose, camera: str, *, width: int, height: int) -> np.ndarray:
        """(height, width, 3) uint8, RGB. The first of a size takes longer."""
        size = height, width
        if size not in self._renderers:
            self._renderers[size] = self._engine.Renderer(self._model, *size)
        data = self._data
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = pose.qpos, pose.mocap_pos, pose.mocap_quat
        self._engine.mj_kinematics(self._model, data)
        self._engine.mj_comPos(self._model, data)
        self._engine.mj_camlight(self._model, data)
        self._renderers[size].update_scene(data, camera)
        return self._renderers[size].render()

    def close(self) -> None:
        """Let go of GL; an open renderer complains when Python ends."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
