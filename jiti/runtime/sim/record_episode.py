"""One scripted demonstration as an MCAP file, the way a recorder on a robot would write it."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from jiti.curate.export.outcome import OUTCOME
from jiti.episodes.mcap_contents import METADATA_NAME
from jiti.episodes.mcap_writer import McapWriter
from jiti.runtime.sim.demonstrators import demonstrator_for
from jiti.runtime.sim.disturbance import Disturbance
from jiti.runtime.sim.episode import run_episode
from jiti.runtime.sim.monitor import Monitor, Outcome
from jiti.runtime.sim.pictures import jpeg
from jiti.runtime.sim.proprio import PROPRIO_NAMES, proprio, spoken_regions
from jiti.runtime.sim.scene import ACTION_NAMES, ARM_JOINTS, CONTROL_HZ, FINGER_JOINTS, Scene, Start
from jiti.runtime.sim.world import GRIPPER
from jiti.tasks.judge import MEASURES, PREDICATES
from jiti.tasks.rotation import quaternion_xyzw

START_NS = 1_735_689_600_000_000_000
"""Log time of the first frame: 2025-01-01, 00:00 UTC. Fixed, so that one seed always gives the same messages."""
STEP_NS = 1_000_000_000 // CONTROL_HZ
_PUSHES = 3
"""What a stream of random numbers is for: the last of its seeds, other than the demonstrator's and the scene's."""


def record_episode(
    path: Path,
    scene: Scene,
    *,
    seed: int,
    quality: float,
    disturbance: float = 0.0,
    start: Start,
    about: Mapping[str, str],
    progress: Callable[[int], None] = lambda _step: None,
) -> Outcome:
    """Demonstrate the scene's task once, from a seed, and write what happened to `path`, with the actions that the
    demonstrator wanted.

    The same arguments give the same messages on one machine, byte for byte. An exception leaves no file. Raises
    SaveFailed when the disk refuses.
    """
    scene.reset(seed, start)
    monitor = Monitor(scene)
    actor = demonstrator_for(scene, seed, quality)
    disturbed = Disturbance(disturbance, np.random.default_rng([seed, _PUSHES]))
    with McapWriter(path, instruction=scene.task.instruction, metadata=about) as writer:

        def watch(step: int, action: np.ndarray | None) -> None:
            write_step(writer, step, scene, monitor, action)
            progress(step)

        outcome = run_episode(monitor, actor, lambda action: scene.step(disturbed(action)), watch)
        write_outcome(writer, outcome)
    return outcome


def write_outcome(writer: McapWriter, outcome: Outcome) -> None:
    """How the episode ended, as metadata."""
    writer.write_metadata(METADATA_NAME, {OUTCOME: json.dumps(outcome.to_json()), "steps": str(outcome.steps)})


def time_of_step(step: int) -> int:
    """Log time in nanoseconds of a step, from 0."""
    return START_NS + step * STEP_NS


def write_step(
    writer: McapWriter,
    step: int,
    scene: Scene,
    monitor: Monitor,
    action: np.ndarray | None,
    pictures: Mapping[str, np.ndarray] | None = None,
) -> None:
    """One step: what was seen, and the action that was then taken; the last step has none.

    `pictures` (height, width, 3) uint8 by camera, where they were rendered already.
    """
    world, time_ns = scene.world, time_of_step(step)
    for camera in scene.cameras:
        picture = scene.render(camera) if pictures is None else pictures[camera]
        writer.write_picture(f"/camera/{camera}", time_ns, jpeg(picture), frame_id=camera)
    fingers = scene.finger_m
    writer.write_joints("/joint_states", time_ns, [*ARM_JOINTS, *FINGER_JOINTS], [*scene.joint_rad, *fingers])
    writer.write_vector("/joint_velocities", time_ns, ARM_JOINTS, scene.joint_rad_s)
    writer.write_vector("/gripper", time_ns, ["opening_m"], [float(np.abs(fingers).sum())])
    writer.write_vector("/proprio", time_ns, PROPRIO_NAMES, proprio(scene))
    _write_pose(writer, "/eef_pose", time_ns, scene.world_T_eef)
    for name in (*world.names.objects, *world.names.fixtures):
        _write_pose(writer, f"/objects/{name}", time_ns, world.pose(name))
    for name in spoken_regions(scene):
        _write_pose(writer, f"/regions/{name}", time_ns, world.pose(name))
    for name in world.names.fixtures:
        if len(joints := world.joints(name)):
            writer.write_vector(f"/fixtures/{name}", time_ns, [f"joint_{k}" for k in range(len(joints))], joints)
    touched = world.contacts()
    things = (*world.names.objects, *world.names.fixtures)
    pairs = [(GRIPPER, name) for name in things]
    pairs += [(a, b) for a in scene.interest if a in world.names.objects for b in things if a != b]
    writer.write_vector("/contacts", time_ns, [f"{a}-{b}" for a, b in pairs], [float(p in touched) for p in pairs])
    writer.write_vector(PREDICATES, time_ns, monitor.predicates, [float(h) for h in monitor.holds])
    # What cannot be measured, as a height over nothing, is missing and not infinite: plots take no infinity.
    measured = [m if np.isfinite(m) else float("nan") for m in monitor.measured]
    writer.write_vector(MEASURES, time_ns, monitor.measures, measured)
    if action is not None:
        writer.write_vector("/action", time_ns, ACTION_NAMES, action)


def _write_pose(writer: McapWriter, topic: str, time_ns: int, pose: np.ndarray) -> None:
    writer.write_pose(topic, time_ns, pose[:3, 3], quaternion_xyzw(pose), frame_id="world")
