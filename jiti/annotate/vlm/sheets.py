"""Contact sheets: frames of one camera in rows, each with its time burned in, as JPEG files for a model."""

import io
from collections.abc import Sequence
from functools import cache
from itertools import batched
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jiti.annotate.vlm.answers import shown_time
from jiti.annotate.vlm.backend import Picture
from jiti.episodes.episode import Episode
from jiti.episodes.video import decode_frames

COLUMNS, ROWS = 4, 3
"""Of a sheet."""
TILE_WIDTH = 256
"""Pixels. Our choice: LIBERO's pictures as they are; a multiple of the 32 that a Qwen3-VL makes one token of."""
CAPTION_HEIGHT = 32
"""Pixels over each frame, for its time: one token high."""
LETTER_HEIGHT = 22
"""Pixels; read without fail at half of this in our pictures of it."""
MOST_HEIGHT = 4 * TILE_WIDTH
"""Pixels of a frame; one that is taller still is squeezed, as a JPEG has at most 65,500."""
GAP = 4
QUALITY = 88
"""Of the JPEG, 1 to 95."""


def contact_sheets(episode: Episode, camera: str, frames: Sequence[int]) -> list[Picture]:
    """Sheets of `COLUMNS` by `ROWS` frames of one camera, in their order; the last sheet has as many rows as it needs.

    Times are seconds since the first frame of the episode. A frame that the camera does not have shows the one before
    it, as a player would. Raises SourceError for a camera or frame that is not there, or a picture that is damaged.
    """
    since_ns = episode.clock.frame_ns - episode.clock.frame_ns[:1]
    tiles = [
        _tile(pixels, f"{shown_time(since_ns[frame] / 1e9)} s")
        for frame, pixels in decode_frames(episode, camera, frames)
    ]
    return [_sheet(some) for some in batched(tiles, COLUMNS * ROWS)]


def sheet_size(width: int, height: int, frames: int) -> list[tuple[int, int]]:
    """Width and height of each sheet of so many frames of a camera, without making it."""
    tile_height = _tile_height(width, height)
    sizes = []
    for some in batched(range(frames), COLUMNS * ROWS):
        rows, columns = -(-len(some) // COLUMNS), min(len(some), COLUMNS)
        sizes.append((columns * (TILE_WIDTH + GAP) - GAP, rows * (tile_height + GAP) - GAP))
    return sizes


def _tile_height(width: int, height: int) -> int:
    return CAPTION_HEIGHT + min(MOST_HEIGHT, max(1, round(TILE_WIDTH * height / max(width, 1))))


def _tile(pixels: np.ndarray, caption: str) -> Image.Image:
    picture = Image.fromarray(pixels)
    height = _tile_height(picture.width, picture.height)
    tile = Image.new("RGB", (TILE_WIDTH, height), "black")
    # Smoother filters take twice the time, and a model does not see the difference.
    size, smooth = (TILE_WIDTH, height - CAPTION_HEIGHT), Image.Resampling.BILINEAR
    tile.paste(picture.resize(size, smooth, reducing_gap=1.5), (0, CAPTION_HEIGHT))
    middle = TILE_WIDTH // 2, CAPTION_HEIGHT // 2
    ImageDraw.Draw(tile).text(middle, caption, "white", _font(), anchor="mm")
    return tile


def _sheet(tiles: Sequence[Image.Image]) -> Picture:
    columns = min(len(tiles), COLUMNS)
    rows = -(-len(tiles) // COLUMNS)
    step_x, step_y = TILE_WIDTH + GAP, max(tile.height for tile in tiles) + GAP
    sheet = Image.new("RGB", (columns * step_x - GAP, rows * step_y - GAP), "dimgrey")
    for k, tile in enumerate(tiles):
        sheet.paste(tile, (k % COLUMNS * step_x, k // COLUMNS * step_y))
    file = io.BytesIO()
    sheet.save(file, "JPEG", quality=QUALITY)
    return Picture(file.getvalue(), sheet.width, sheet.height)


@cache
def _font() -> Any:
    """The font that comes with Pillow, so that a sheet looks the same on every machine."""
    return ImageFont.load_default(LETTER_HEIGHT)
