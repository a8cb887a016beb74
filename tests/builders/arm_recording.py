"""A recording of an arm, without an arm: two cameras whose pictures tell their number by their shade, six joints."""

from pathlib import Path

import numpy as np

from jiti.episodes.mcap_writer import McapWriter
from jiti.runtime.sim.pictures import jpeg

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
PERIOD_NS = 33_333_333


def write_arm_recording(path: Path, task: str = "so100/T5", frames: int = 60) -> Path:
    """At 30 Hz; the first joint moves until the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with McapWriter(path, instruction="close it", metadata={"task": task}) as writer:
        for frame in range(frames):
            at = 10**18 + frame * PERIOD_NS
            for camera, lighter in (("front", 0), ("wrist", 40)):
                shade = np.full((48, 64, 3), 3 * frame + lighter, np.uint8)
                writer.write_picture(f"/camera/{camera}", at, jpeg(shade))
            joints = [float(frame), 0.0, 0.0, 0.0, 0.0, 50.0]
            writer.write_vector("/joints", at, [f"{name}.pos" for name in JOINTS], joints)
    return path
