"""A recording of an arm that lets a bottle go over a basket: camera, gripper, hand, poses and contacts."""

from pathlib import Path

import numpy as np

from jiti.episodes.mcap_writer import McapWriter
from tests.builders.encode import encode_numbered

STEP_NS = 50_000_000
START_NS = 1_735_689_600_000_000_000
CLOSES, OPENS = 20, 55
"""Frames at which the gripper has closed, and begins to open."""
KETCHUP = "pick up the ketchup and place it in the basket"
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def write_demonstration(
    path: Path,
    *,
    instruction: str = KETCHUP,
    drop_m: float = 0.0,
    poses: bool = True,
    cameras: tuple[str, ...] = ("front",),
    steps: int = 80,
    task: str | None = "elegant/T0",
) -> None:
    """The bottle is held from `CLOSES` to `OPENS` and falls by `drop_m` when it is let go; then it rests."""
    metadata = {} if task is None else {"task": task}
    with McapWriter(path, instruction=instruction, metadata=metadata) as writer:
        for step in range(steps):
            time_ns = START_NS + step * STEP_NS
            for k, camera in enumerate(cameras):
                writer.write_picture(f"/camera/{camera}", time_ns, encode_numbered([step + 7 * k], "jpeg", 64, 48)[0])
            held = CLOSES <= step < OPENS
            writer.write_vector("/gripper", time_ns, ["opening_m"], [0.04 if held else 0.08])
            carried = np.clip((step - CLOSES) / (OPENS - CLOSES - 10), 0, 1)
            hand = np.array([0.3 * carried, 0.0, 0.1 + 0.2 * np.sin(np.pi * carried)])
            writer.write_pose("/eef_pose", time_ns, hand, LEVEL, frame_id="world")
            if not poses:
                continue
            fallen = 0.0 if step < OPENS else min(drop_m, 0.5 * 9.81 * ((step - OPENS + 1) * 0.05) ** 2)
            writer.write_pose("/objects/ketchup_1", time_ns, hand - [0, 0, 0.05 + fallen], LEVEL, frame_id="world")
            writer.write_pose("/objects/basket_1", time_ns, np.array([0.3, 0.0, 0.0]), LEVEL, frame_id="world")
            landed = step >= OPENS and fallen >= drop_m
            names = ["gripper-ketchup_1", "gripper-basket_1", "ketchup_1-basket_1"]
            writer.write_vector("/contacts", time_ns, names, [float(held), 0.0, float(landed)])
