"""Scripted experts, one for each simulated task, whose care is a parameter."""

import importlib

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.sim.demonstrators.motion import Demonstrator
from jiti.runtime.sim.scene import Scene

_EXPERTS = {
    "elegant/T0": "place.Place",
    "elegant/T1": "place.Place",
    "elegant/T2": "place.PlaceOffCentre",
    "elegant/T3": "stove.TurnOnAndPlace",
    "elegant/T4": "caddy.IntoCaddy",
    "elegant/T5": "caddy.IntoCaddy",
    "elegant/T6": "push.PushPlate",
    "elegant/T7": "shelf.OntoShelf",
    "rq3": "place.Place",
    "g4/ketchup": "place.Place",
    "g4/cream-cheese": "place.Place",
    "g4/black-bowl": "place.Place",
    "g4/close-bottom-drawer": "close.CloseSmoothly",
    "g4/close-top-drawer": "close.CloseSmoothly",
    "g4/close-microwave": "close.CloseSmoothly",
}
"""Module and class in this folder, by task id or by the part of it before the slash."""


def demonstrator_for(scene: Scene, quality: float, random: np.random.Generator) -> Demonstrator:
    """The expert for a scene's task, at its start. Raises UsageError when no one knows how to do it."""
    task_id = scene.task.task_id
    place = _EXPERTS.get(task_id) or _EXPERTS.get(task_id.partition("/")[0])
    if place is None:
        raise UsageError(f"there is no scripted expert for {task_id}; there are some for: {', '.join(_EXPERTS)}")
    module, _, name = place.partition(".")
    expert: type[Demonstrator] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
    return expert(scene, quality, random)
