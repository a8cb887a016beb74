"""Contact sheets of real recordings: each frame under its own time, in order, as large as they were said to be."""

import io
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

from jiti.annotate.vlm.answers import shown_time
from jiti.annotate.vlm.backend import Picture
from jiti.annotate.vlm.sheets import CAPTION_HEIGHT, COLUMNS, GAP, LETTER_HEIGHT, TILE_WIDTH, contact_sheets, sheet_size
from jiti.episodes.episode import Episode
from jiti.episodes.mcap_writer import McapWriter
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError
from tests.builders.encode import encode_numbered
from tests.builders.pictures import read_number

START_NS = 1_735_689_600_000_000_000
STEP_NS = 50_000_000
CAMERA = "/camera/front"


def opened(path: Path) -> Episode:
    reader = open_reader(path)
    return reader.open(reader.episodes()[0].episode_id)


def recorded(
    folder: Path, width: int = 64, height: int = 48, *, steps: int = 40, image: str = "jpeg", step_ns: int = STEP_NS
) -> Episode:
    path = folder / f"{width}x{height}.mcap"
    with McapWriter(path) as writer:
        for step in range(steps):
            writer.write_picture(CAMERA, START_NS + step * step_ns, encode_numbered([step], image, width, height)[0])
    return opened(path)


def decoded(sheet: Picture) -> np.ndarray:
    picture = Image.open(io.BytesIO(sheet.jpeg))
    assert picture.format == "JPEG"
    assert picture.mode == "RGB"
    assert picture.size == (sheet.width, sheet.height)
    return np.asarray(picture)


def tiles(sheet: Picture, count: int, tile_height: int) -> list[np.ndarray]:
    """Left to right, then down."""
    pixels = decoded(sheet)
    tops = [k // COLUMNS * (tile_height + GAP) for k in range(count)]
    lefts = [k % COLUMNS * (TILE_WIDTH + GAP) for k in range(count)]
    return [pixels[top : top + tile_height, left : left + TILE_WIDTH] for top, left in zip(tops, lefts, strict=True)]


@cache
def caption_of(text: str) -> np.ndarray:
    """White on black, centred: what should stand over a frame."""
    strip = Image.new("L", (TILE_WIDTH, CAPTION_HEIGHT), 0)
    font = ImageFont.load_default(LETTER_HEIGHT)
    ImageDraw.Draw(strip).text((TILE_WIDTH // 2, CAPTION_HEIGHT // 2), text, 255, font, anchor="mm")
    return np.asarray(strip, float)


def read_caption(tile: np.ndarray, times: Sequence[str]) -> str:
    """The time whose picture is nearest to what stands over the tile."""
    strip = tile[:CAPTION_HEIGHT].astype(float).mean(axis=2)
    return min(times, key=lambda time: float(np.abs(strip - caption_of(f"{time} s")).mean()))


def times_of(frames: Sequence[int]) -> list[str]:
    return [shown_time(frame * STEP_NS / 1e9) for frame in frames]


@pytest.mark.parametrize(("width", "height"), [(64, 48), (48, 64), (320, 240), (200, 30)])
def test_sheets_are_as_large_as_they_were_said_to_be(tmp_path, width, height):
    episode = recorded(tmp_path, width, height, steps=26)
    for count in (1, 4, 5, 25):
        sheets = contact_sheets(episode, CAMERA, range(count))
        assert [(sheet.width, sheet.height) for sheet in sheets] == sheet_size(width, height, count)
        for sheet in sheets:
            decoded(sheet)


def test_no_frames_make_no_sheet(tmp_path):
    assert contact_sheets(recorded(tmp_path), CAMERA, []) == []
    assert sheet_size(64, 48, 0) == []


def test_sizes_by_hand():
    assert sheet_size(256, 256, 4) == [(4 * 260 - 4, 288)]
    assert sheet_size(640, 480, 17) == [(1036, 3 * 228 - 4), (1036, 2 * 228 - 4)]
    assert sheet_size(640, 480, 1) == [(256, 224)]


def test_frames_stand_left_to_right_then_down_each_under_its_time(tmp_path):
    frames = [0, 1, 2, 5, 9, 10, 20, 21, 22, 30, 31, 38, 39]
    first, second = contact_sheets(recorded(tmp_path), CAMERA, frames)
    shown = tiles(first, 12, CAPTION_HEIGHT + 192) + tiles(second, 1, CAPTION_HEIGHT + 192)
    assert [read_number(tile[CAPTION_HEIGHT:]) for tile in shown] == frames
    every = times_of(range(40))
    assert [read_caption(tile, every) for tile in shown] == times_of(frames)


def test_frames_are_put_in_order_and_shown_once(tmp_path):
    (sheet,) = contact_sheets(recorded(tmp_path), CAMERA, [9, 3, 3, 0])
    assert [read_number(tile[CAPTION_HEIGHT:]) for tile in tiles(sheet, 3, CAPTION_HEIGHT + 192)] == [0, 3, 9]
    assert sheet.width == 3 * (TILE_WIDTH + GAP) - GAP


def test_a_time_is_white_on_black_and_sharp_after_compression(tmp_path):
    """All of a strip is black but its letters, and JPEG leaves them as they were drawn."""
    frames = [0, 7, 33]
    (sheet,) = contact_sheets(recorded(tmp_path), CAMERA, frames)
    strips = [tile[:CAPTION_HEIGHT].astype(float) for tile in tiles(sheet, 3, CAPTION_HEIGHT + 192)]
    for time, strip in zip(times_of(frames), strips, strict=True):
        grey, drawn = strip.mean(axis=2), caption_of(f"{time} s")
        assert (np.ptp(strip, axis=2) < 30).mean() > 0.95  # the border of a picture bleeds into the strip's last rows
        assert np.abs(grey - drawn)[:-4].max() < 80
        assert grey[drawn == 255].min() > 200
        assert grey[:-4][drawn[:-4] == 0].mean() < 3
        lit = np.flatnonzero((grey[:-4] > 128).any(axis=1))
        assert 14 <= np.ptp(lit) + 1 <= LETTER_HEIGHT
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(strips[a] - strips[b]).mean() > 2


def test_times_count_from_the_first_frame_and_are_those_of_the_clock(tmp_path):
    """A clock that starts long after 1970 and runs at 29.97 Hz."""
    episode = recorded(tmp_path, steps=35, step_ns=33_366_667)
    (sheet,) = contact_sheets(episode, CAMERA, [0, 1, 17, 34])
    shown = tiles(sheet, 4, CAPTION_HEIGHT + 192)
    every = [f"{k / 100:.2f}" for k in range(120)]
    assert [read_caption(tile, every) for tile in shown] == ["0.00", "0.03", "0.57", "1.13"]


def test_a_camera_that_lags_shows_the_picture_before_and_none_before_its_first(tmp_path):
    with McapWriter(tmp_path / "two.mcap") as writer:
        for step in range(30):
            time_ns = START_NS + step * STEP_NS
            writer.write_picture(CAMERA, time_ns, encode_numbered([step], "jpeg", 64, 48)[0])
            if step >= 10 and step % 2 == 0:
                writer.write_picture("/camera/wrist", time_ns, encode_numbered([step + 100], "jpeg", 64, 64)[0])
    episode = opened(tmp_path / "two.mcap")
    assert episode.clock.reference == CAMERA
    (sheet,) = contact_sheets(episode, "/camera/wrist", [0, 9, 10, 11, 12, 29])
    shown = tiles(sheet, 4, CAPTION_HEIGHT + 256)
    assert [read_number(tile[CAPTION_HEIGHT:]) for tile in shown] == [110, 110, 112, 128]
    assert [read_caption(tile, times_of(range(30))) for tile in shown] == ["0.50", "0.55", "0.60", "1.45"]


def test_the_same_frames_are_the_same_bytes(tmp_path):
    """An answer is kept by the pictures that it was given for."""
    episode = recorded(tmp_path)
    once, again = (contact_sheets(episode, CAMERA, [0, 20, 39]) for _ in range(2))
    assert once == again
    assert once != contact_sheets(episode, CAMERA, [0, 21, 39])


def test_what_is_not_there_is_said(tmp_path):
    episode = recorded(tmp_path)
    with pytest.raises(SourceError, match="no camera '/camera/wrist'; it has: /camera/front"):
        contact_sheets(episode, "/camera/wrist", [0])
    with pytest.raises(SourceError, match="has no frame 40; it has 0 to 39"):
        contact_sheets(episode, CAMERA, [0, 40])


def test_a_damaged_picture_is_said_with_its_frame(tmp_path):
    good = encode_numbered([1], "jpeg", 320, 240)[0]
    with McapWriter(tmp_path / "bad.mcap") as writer:
        for step in range(5):
            writer.write_picture(CAMERA, START_NS + step * STEP_NS, good if step != 3 else good[:2500])
    episode = opened(tmp_path / "bad.mcap")
    assert len(contact_sheets(episode, CAMERA, [0, 1, 2, 4])) == 1
    with pytest.raises(SourceError, match="/camera/front, frame 3"):
        contact_sheets(episode, CAMERA, [2, 3])


def test_a_picture_of_no_sensible_shape_gives_a_sheet_or_is_said(tmp_path):
    episode = recorded(tmp_path, 4, 1100, steps=2, image="png")
    try:
        sheets = contact_sheets(episode, CAMERA, [0])
    except SourceError:
        return
    assert [(sheet.width, sheet.height) for sheet in sheets] == sheet_size(4, 1100, 1)
