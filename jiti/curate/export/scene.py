"""`observation.environment_state` of a simulator's recording: the vector that the simulator's environment gives."""

import numpy as np

from jiti.annotate.readings import GRIPPER, Readings
from jiti.episodes.episode import Episode
from jiti.errors import SourceError
from jiti.tasks.scene_state import roles, scene_state
from jiti.tasks.task import Task

CONTACTS = "/contacts"
REGIONS = "/regions/"


def recorded_scene_state(episode: Episode, task: Task | None, title: str) -> np.ndarray:
    """(frames of the recording, n) float32. Raises SourceError when a pose or the contacts are missing.

    The recorder names contacts `gripper-a` for every thing in the scene's order, then `a-b` for what the task moves:
    that is where the order of things and what moves are read from.
    """
    readings = Readings(episode)
    contacts = episode.streams.get(CONTACTS)
    if contacts is None or not contacts.names or readings.hand_m is None:
        raise SourceError(
            f"{title}: has no {CONTACTS} or no place of the hand, from which the scene's state is made. "
            "Leave observation.environment_state out with --features."
        )
    pairs = [name.partition("-") for name in contacts.names]
    bodies = list(dict.fromkeys(b for a, _, b in pairs if a == GRIPPER))
    moved = list(dict.fromkeys(a for a, _, _ in pairs if a != GRIPPER))
    regions = [name.removeprefix(REGIONS) for name in episode.streams if name.startswith(REGIONS)]
    order = roles(task, (*bodies, *regions), moved=moved, regions=regions)
    poses: dict[str, np.ndarray] = {}
    for name in order:
        pose = readings.pose(name)
        if pose is None:
            raise SourceError(
                f"{title}: the pose of {name!r} is missing or has gaps, and the scene's state needs it. "
                "Leave the recording out with --filter, or observation.environment_state with --features."
            )
        poses[name] = pose
    touched = readings.touching(GRIPPER, order[0])
    if touched is None:
        touched = np.zeros(readings.frames, bool)
    joints = {name: stand for name in order if (stand := readings.joints(name)) is not None}
    return scene_state(readings.hand_m, poses, order, touched, joints)
