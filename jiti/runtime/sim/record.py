"""Scripted picks, recorded to MCAP the way a recorder on a robot would."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from jiti.episodes.mcap_writer import METADATA_NAME, McapWriter
from jiti.errors import UsageError
from jiti.runtime.sim.engine import find_robosuite
from jiti.runtime.sim.gl import Graphics, find_graphics
from jiti.runtime.sim.lift import (
    ACTION_NAMES,
    ARM_JOINTS,
    CAMERAS,
    CONTROL_HZ,
    FINGER_JOINTS,
    INSTRUCTION,
    PICTURE_SIZE,
    TASK_ID,
    LiftScene,
    Observation,
)
from jiti.runtime.sim.pick import ScriptedPick, draw_manner

START_NS = 1_735_689_600_000_000_000
"""Log time of the first frame: 2025-01-01, 00:00 UTC. Fixed, so that one seed always gives the same bytes."""
JPEG_QUANTIZER = 3
"""Of FFmpeg's mjpeg encoder, 2 (best) to 31. Our choice: no visible blocks, 10 to 15 kB a picture."""
TYPICAL_STEPS = 80
"""Steps of an episode, for progress alone. Measured: 68 to 90."""

Progress = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and what is being done."""


def record_demo(
    folder: Path,
    *,
    episodes: int = 1,
    seed: int = 0,
    graphics: Graphics | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Record picks of a cube as `folder/pick_000.mcap` and on, and give their paths.

    Recordings that are there already are kept, so that a stopped run goes on where it was. Without a GL library they
    hold numbers only. One seed gives the same messages on one machine, byte for byte. Raises UsageError when the
    simulation cannot run here or a file of that name holds something else, SaveFailed when the disk refuses.
    """
    report = progress or (lambda _share, _what: None)
    if episodes < 1:
        raise UsageError(f"{episodes} episodes cannot be recorded; give 1 or more")
    paths = [folder / f"pick_{number:03d}.mcap" for number in range(episodes)]
    missing = [number for number, path in enumerate(paths) if not _is_kept(path, seed, number)]
    if missing:
        find_robosuite()
        graphics = graphics or find_graphics()
        report(0.0, graphics.message)
        for done, number in enumerate(missing):

            def step(count: int, done: int = done, number: int = number) -> None:
                share = (done + min(count / TYPICAL_STEPS, 1.0)) / len(missing)
                report(share, f"recording {paths[number].name}")

            _record(paths[number], seed, number, graphics, step)
    report(1.0, f"{len(missing)} recorded, {episodes - len(missing)} kept")
    return paths


def recorded_metadata(path: Path) -> Mapping[str, str]:
    """What the recorder wrote of itself in a recording: task, seed, episode, manner, steps, lifted, ...

    Empty when it wrote nothing, or the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            records = [record.metadata for record in make_reader(file).iter_metadata() if record.name == METADATA_NAME]
    except (McapError, OSError):
        return {}
    return {key: value for record in records for key, value in record.items()}


def _is_kept(path: Path, seed: int, number: int) -> bool:
    if not path.exists():
        return False
    found = recorded_metadata(path)
    if (found.get("task"), found.get("seed"), found.get("episode")) != (TASK_ID, str(seed), str(number)):
        what = f"a recording with seed {found['seed']}" if "seed" in found else "another recording"
        raise UsageError(
            f"{path} is {what}, and recordings are not replaced. "
            f"Choose another folder for seed {seed}, or move that file away."
        )
    return True


def _record(path: Path, seed: int, number: int, graphics: Graphics, progress: Callable[[int], None]) -> None:
    # Streams of their own for the scene and the script: an episode does not depend on those before it.
    scene_seed, script_seed = np.random.SeedSequence([seed, number]).spawn(2)
    random = np.random.default_rng(script_seed)
    manner = draw_manner(random)
    script = ScriptedPick(manner, random)
    about = {
        "task": TASK_ID,
        "seed": str(seed),
        "episode": str(number),
        "manner": json.dumps(asdict(manner)),
        "pictures": graphics.backend or "none",
    }
    with (
        LiftScene(graphics, seed=int(scene_seed.generate_state(1)[0])) as scene,
        McapWriter(path, instruction=INSTRUCTION, metadata=about) as writer,
    ):
        count = 0
        while True:
            seen = scene.observe()
            action = script.act(seen)
            time_ns = START_NS + count * (1_000_000_000 // CONTROL_HZ)
            _write(writer, time_ns, seen, action)
            count += 1
            progress(count)
            if action is None:
                break
            scene.step(action)
        writer.write_metadata(METADATA_NAME, {"steps": str(count), "lifted": "true" if scene.is_lifted() else "false"})


def _write(writer: McapWriter, time_ns: int, seen: Observation, action: np.ndarray | None) -> None:
    """One step: what was seen, and the action that was then taken; the last step has none."""
    for camera in CAMERAS:
        if camera in seen.pictures:
            name = camera.removeprefix("robot0_")
            writer.write_picture(f"/camera/{name}", time_ns, jpeg(seen.pictures[camera]), frame_id=name)
    writer.write_joints(
        "/joint_states",
        time_ns,
        [*ARM_JOINTS, *FINGER_JOINTS],
        [*seen.joint_rad, *seen.finger_m],
    )
    writer.write_vector("/joint_velocities", time_ns, ARM_JOINTS, seen.joint_rad_s.tolist())
    writer.write_vector("/gripper", time_ns, ["opening_m"], [seen.opening_m])
    for topic, pose in (("/eef_pose", seen.world_T_hand), ("/cube_pose", seen.world_T_cube)):
        writer.write_pose(topic, time_ns, pose[:3, 3].tolist(), quaternion_xyzw(pose).tolist(), frame_id="world")
    # Fingers that touch the cube, 0 to 2, and whether the gripper touches the table.
    writer.write_vector("/contact", time_ns, ["cube", "table"], [sum(seen.touches_cube), seen.touches_table])
    if action is not None:
        writer.write_vector("/action", time_ns, ACTION_NAMES, action.tolist())


def jpeg(picture: np.ndarray) -> bytes:
    """An RGB picture (256, 256, 3) uint8 as a JPEG file; the same picture always gives the same bytes."""
    codec: Any = av.CodecContext.create("mjpeg", "w")
    codec.width = codec.height = PICTURE_SIZE
    codec.pix_fmt, codec.time_base, codec.thread_count = "yuvj420p", Fraction(1, CONTROL_HZ), 1
    codec.qmin = codec.qmax = JPEG_QUANTIZER
    frame = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="yuvj420p", dst_color_range="JPEG")
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])


def quaternion_xyzw(pose: np.ndarray) -> np.ndarray:
    """(4,) unit quaternion of a rotation (3, 3) or pose (4, 4), w not negative (Bar-Itzhack 2000, version 3)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = pose[:3, :3]
    symmetric = np.array(
        [
            [xx - yy - zz, yx + xy, zx + xz, zy - yz],
            [yx + xy, yy - xx - zz, zy + yz, xz - zx],
            [zx + xz, zy + yz, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    quaternion = np.linalg.eigh(symmetric)[1][:, -1]
    return quaternion if quaternion[3] >= 0 else -quaternion
