"""Recordings like those of real robots: two textured, moving JPEG cameras, joints and actions."""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np
from bench import Bench, Say

from jiti.episodes.mcap_writer import McapWriter

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
NUMBERS_HZ = 50
CAMERAS = ("/camera/front", "/camera/wrist")
JOINTS = [f"joint_{k}" for k in range(1, 7)] + ["gripper"]
START_NS = 1_735_689_600_000_000_000
BANK_S = 60
"""Seconds of pictures that are drawn; longer recordings repeat them."""
BORDER_RGB = (255, 0, 255)
BORDER = 8
"""Pixels of a colour that no page has, around every picture: a screenshot with it shows the picture."""
QUANTIZER = 8
"""Of FFmpeg's mjpeg encoder. With the texture below, pictures take about 15 KB."""
LARGE_QUANTIZER = 2
"""With sensor noise: pictures of about 100 KB."""


def recording(bench: Bench, seconds: int, *, large_pictures: bool = False) -> Path:
    """A recording of this length, made once."""
    name = f"{seconds}s-large.mcap" if large_pictures else f"{seconds}s.mcap"
    path = bench.kept / "recordings-3" / name
    if not path.exists():
        with bench.progress(f"Making {name}") as say:
            _write(path, seconds, large_pictures, say)
    return path


def episodes(bench: Bench, seconds: int, count: int) -> Path:
    """A folder of recordings of this length with the same pictures and another instruction each, made once."""
    folder = bench.kept / "recordings-3" / f"{count}-of-{seconds}s"
    folder.mkdir(parents=True, exist_ok=True)
    missing = [k for k in range(count) if not (folder / f"episode_{k:03}.mcap").exists()]
    if missing:
        with bench.progress(f"Making {count} recordings") as say:
            banks = _banks(seconds, False, say)
            for k in missing:
                _write_with(banks, folder / f"episode_{k:03}.mcap", seconds, f"Pick up cube {k}.", say)
    return folder


def _write(path: Path, seconds: int, large_pictures: bool, say: Say) -> None:
    _write_with(_banks(seconds, large_pictures, say), path, seconds, "Pick up the cube.", say)


def _banks(seconds: int, large_pictures: bool, say: Say) -> list[Sequence[bytes]]:
    return [_bank(k, min(seconds, BANK_S), large_pictures, say) for k in range(len(CAMERAS))]


def _write_with(banks: list[Sequence[bytes]], path: Path, seconds: int, instruction: str, say: Say) -> None:
    with McapWriter(path, instruction=instruction, overwrite=True) as writer:
        for second in range(seconds):
            for time_ns, kind in _ticks(second):
                if kind < len(CAMERAS):
                    frame = (time_ns - START_NS) * RATE_HZ // 10**9
                    writer.write_picture(CAMERAS[kind], time_ns, banks[kind][frame % len(banks[kind])])
                else:
                    position = _position((time_ns - START_NS) / 1e9)
                    writer.write_joints("/joint_states", time_ns, JOINTS, position, velocity=np.gradient(position))
                    writer.write_vector("/action", time_ns + 1, JOINTS, position + 0.01)
            say(second / seconds, f"second {second} of {seconds}")


@cache
def _ticks(second: int) -> list[tuple[int, int]]:
    """Times within a second with the camera's number, or the count of cameras for numbers; in order."""
    start = START_NS + second * 10**9
    ticks = [(start + k * 10**9 // NUMBERS_HZ, len(CAMERAS)) for k in range(NUMBERS_HZ)]
    for camera in range(len(CAMERAS)):
        # Rounded up, so that a frame's number follows from its time. Triggered together, so that all show frame 0.
        ticks += [(start + -(-k * 10**9 // RATE_HZ), camera) for k in range(RATE_HZ)]
    return sorted(ticks)


def _position(time_s: float) -> np.ndarray:
    """Joint angles (7,) of an arm that swings; the gripper closes every ten seconds."""
    angles = [math.sin(time_s * (0.3 + 0.1 * k) + k) for k in range(len(JOINTS) - 1)]
    return np.array([*angles, 0.04 if time_s % 10 < 5 else 0.0])


def _bank(camera: int, seconds: int, large_pictures: bool, say: Say) -> Sequence[bytes]:
    """JPEG pictures of a camera that moves over a textured scene in which a dark arm moves."""
    draw = np.random.default_rng(camera)
    scene = _texture(draw, 2 * HEIGHT, 2 * WIDTH)
    noise = draw.integers(-24, 24, (HEIGHT, WIDTH, 3), np.int16)
    codec: Any = av.CodecContext.create("mjpeg", "w")
    codec.width, codec.height, codec.pix_fmt, codec.time_base = WIDTH, HEIGHT, "yuvj420p", Fraction(1, RATE_HZ)
    codec.qmin = codec.qmax = LARGE_QUANTIZER if large_pictures else QUANTIZER
    codec.thread_count = 1
    pictures = []
    for frame in range(seconds * RATE_HZ):
        x = round(WIDTH / 2 * (1 + math.sin(frame / 90 + camera)))
        y = round(HEIGHT / 2 * (1 + math.cos(frame / 140)))
        picture = scene[y : y + HEIGHT, x : x + WIDTH].copy()
        left = round((WIDTH - 90) / 2 * (1 + math.sin(frame / 50)))
        picture[:300, left : left + 90] //= 3
        if large_pictures:
            picture = np.clip(picture + np.roll(noise, frame * 7, (0, 1)), 0, 255).astype(np.uint8)
        for edge in (np.s_[:BORDER], np.s_[-BORDER:], np.s_[:, :BORDER], np.s_[:, -BORDER:]):
            picture[edge] = BORDER_RGB
        yuv = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="yuvj420p", dst_color_range="JPEG")
        pictures += [bytes(packet) for packet in codec.encode(yuv)]
        say(frame / (seconds * RATE_HZ), f"pictures of {CAMERAS[camera]}")
    pictures += [bytes(packet) for packet in codec.encode(None)]
    return pictures


def _texture(draw: np.random.Generator, height: int, width: int) -> np.ndarray:
    """(height, width, 3) uint8: a scene with large and small structure, softly lit."""
    total = np.zeros((height, width, 3))
    for size, weight in ((6, 0.6), (20, 1.5), (90, 3.0), (300, 4.0)):
        shape = (height // size + 2, width // size + 2)
        grid = draw.normal(size=(*shape, 1)) + 0.2 * draw.normal(size=(*shape, 3))  # more light than colour
        rows, columns = (np.linspace(0, n / size, n) for n in (height, width))
        i, j = rows.astype(int), columns.astype(int)
        a, b = (rows - i)[:, None, None], (columns - j)[:, None]
        upper = grid[i][:, j] * (1 - b) + grid[i][:, j + 1] * b
        lower = grid[i + 1][:, j] * (1 - b) + grid[i + 1][:, j + 1] * b
        total += weight * (upper * (1 - a) + lower * a)
    return np.clip(128 + 18 * total, 0, 255).astype(np.uint8)
