"""Floors and walls as small pictures, under the names that LIBERO's arenas put into a scene."""

import math
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

SIZE = 64
"""Pixels on a side."""

Shade = Callable[[int, int, random.Random], float]
"""Brightness from 0 to 1 at column x and row y."""


def write_textures(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, dark, light, shade in (
        ("light-gray-floor-tile.png", (120, 118, 114), (205, 201, 195), _planks),
        ("gray_ceramic_tile.png", (95, 95, 95), (150, 150, 148), _tiles),
        ("seamless_wood_planks_floor.png", (95, 62, 38), (165, 115, 74), _planks),
        ("light-gray-plaster.png", (150, 150, 150), (190, 190, 188), _plaster),
        ("yellow_linen_wall_texture.png", (165, 155, 120), (205, 195, 155), _linen),
    ):
        (folder / name).write_bytes(_png(dark, light, shade))


def _planks(x: int, y: int, noise: random.Random) -> float:
    """Four boards along y, each with its own tone and a joint."""
    board = x // 16
    seam = x % 16 == 0 or y == (board * 37) % SIZE
    return 0.0 if seam else 0.7 + 0.1 * ((board * 7) % 4) / 3 + 0.06 * math.sin(2.1 * x) + 0.08 * noise.random()


def _tiles(x: int, y: int, noise: random.Random) -> float:
    return 0.0 if x % 32 == 0 or y % 32 == 0 else 0.8 + 0.2 * noise.random()


def _plaster(x: int, y: int, noise: random.Random) -> float:
    return 0.75 + 0.25 * noise.random()


def _linen(x: int, y: int, noise: random.Random) -> float:
    return 0.6 + 0.15 * (x % 2) + 0.15 * (y % 2) + 0.1 * noise.random()


def _png(dark: tuple[int, ...], light: tuple[int, ...], shade: Shade) -> bytes:
    """A picture of 16 tones between two colours, stored uncompressed, so that every machine writes the same bytes."""
    noise = random.Random(0)
    tones = bytes(round(d + (o - d) * tone / 15) for tone in range(16) for d, o in zip(dark, light, strict=True))
    rows = b"".join(
        b"\0" + bytes(min(15, max(0, round(15 * shade(x, y, noise)))) for x in range(SIZE)) for y in range(SIZE)
    )
    header = struct.pack(">IIBBBBB", SIZE, SIZE, 8, 3, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"PLTE", tones), (b"IDAT", zlib.compress(rows, level=0)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
