"""Where things are, as one vector of the same size for every task: what policies and critics see of a simulated scene.

Tasks have different things in different numbers. Each is given a place by its role: first what the hand moves, then
where it goes, then what an ITC speaks of, then the rest. So a bottle and a carton that go into a basket look alike, and
one network learns all tasks. Recordings (`jiti.curate`) and the simulator (`jiti.runtime`) make the same vector here.
"""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from jiti.tasks.goal import atoms, parse_goal
from jiti.tasks.rotation import matrices
from jiti.tasks.task import Task

SLOTS = 8
"""Things that have a place; more are left out. Our choice: the fullest scenes of LIBERO-Elegant (T2, T6) have eight."""
JOINTS = 3
"""Moving parts of a thing that are told; more are left out. Our choice: LIBERO's cabinets have three drawers, its stove
a knob, its microwave a door."""
_AXES = ("x", "y", "z")


def roles(
    task: Task | None, things: Sequence[str], *, moved: Sequence[str] = (), regions: Sequence[str] = ()
) -> list[str]:
    """The names of things in the order of their places, at most `SLOTS`.

    `things` have a pose, in the order of the scene; `moved` are objects of interest in the task's order, of which the
    first is what the hand moves, and `regions` are those of `things` that are places and not bodies.
    """
    spoken = (
        [name for itc in task.itcs if itc.goal for atom in atoms(parse_goal(itc.goal)) for name in atom.arguments]
        if task
        else []
    )
    order = dict.fromkeys((*moved[:1], *regions, *moved[1:], *spoken, *things))
    return [name for name in order if name in things][:SLOTS]


def scene_state_names() -> tuple[str, ...]:
    """What the numbers of a `scene_state` are, (n,)."""
    names = ["thing_0.touched"]
    for slot in range(SLOTS):
        names += [f"thing_{slot}.from_hand.{axis}_m" for axis in _AXES]
        names += [f"thing_{slot}.from_thing_0.{axis}_m" for axis in _AXES] if slot else []
        names += [f"thing_{slot}.{column}_axis.{axis}" for column in ("x", "z") for axis in _AXES]
        names += [f"thing_{slot}.joint_{joint}" for joint in range(JOINTS)]
    return tuple(names)


def scene_state(
    hand_m: np.ndarray,
    poses: Mapping[str, np.ndarray],
    order: Iterable[str],
    touched: np.ndarray,
    joints: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> np.ndarray:
    """(T, n) float32, of the hand's place (T, 3) in the world, poses (T, 7) in the world with x, y, z in m and a
    quaternion x, y, z, w, whether the hand touches the first thing (T,), and how far the moving parts of things stand,
    (T, any) in m or rad.

    All in the world's axes: places from the hand's place and from the first thing's, and the x and z axes of each
    thing. Places that no thing has are zeros, and so are parts.
    """
    frames, named = len(hand_m), [*order][:SLOTS]
    pose = np.stack([poses[name] for name in named], axis=1)
    places, turned = pose[..., :3], matrices(pose[..., 3:].reshape(-1, 4)).reshape(*pose.shape[:2], 3, 3)
    slots = np.zeros((frames, SLOTS, 12 + JOINTS))
    things = slots[:, : len(named)]
    things[..., 0:3] = places - hand_m[:, None]
    things[..., 3:6] = places - places[:, :1]
    things[..., 6:9], things[..., 9:12] = turned[..., 0], turned[..., 2]
    for slot, name in enumerate(named):
        if name in joints:
            stand = joints[name][:, :JOINTS]
            slots[:, slot, 12 : 12 + stand.shape[1]] = stand
    told = slots.reshape(frames, SLOTS * (12 + JOINTS))
    touched = np.asarray(touched, np.float64).reshape(frames, 1)
    # The first thing's place from itself is left out.
    return np.concatenate([touched, told[:, :3], told[:, 6:]], axis=1).astype(np.float32)
