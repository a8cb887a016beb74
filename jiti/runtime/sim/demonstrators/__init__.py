"""Scripted experts, one for each simulated task, whose care is a parameter."""

import importlib

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.sim.demonstrators.motion import Demonstrator
from jiti.runtime.sim.scene import Scene
from jiti.tasks.task import Task

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


GOLDEN = (5**0.5 - 1) / 2
"""Multiples of it, modulo 1, fill 0 to 1 evenly however many there are (Weyl)."""


def is_careful(seed: int, quality: float) -> bool:
    """Whether the episode of a seed is meant to be elegant: of any seeds in a row, about a share of `quality`."""
    return (seed * GOLDEN + 0.5) % 1 < quality


def expert_for(task: Task) -> type[Demonstrator]:
    """Who knows how to do a task. Raises UsageError when no one does."""
    place = _EXPERTS.get(task.task_id) or _EXPERTS.get(task.task_id.partition("/")[0])
    if place is None:
        raise UsageError(f"there is no scripted expert for {task.task_id}; there are some for: {', '.join(_EXPERTS)}")
    module, _, name = place.partition(".")
    return getattr(importlib.import_module(f"{__name__}.{module}"), name)


def demonstrator_for(scene: Scene, seed: int, quality: float) -> Demonstrator:
    """The expert for a scene that was reset with a seed. Raises UsageError when no one knows how to do its task."""
    random = np.random.default_rng([seed, 1])
    return expert_for(scene.task)(scene, careful=is_careful(seed, quality), random=random)
