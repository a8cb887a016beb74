"""Whether the rows of a LeRobot episode are what the dataset says they are."""

from collections.abc import Iterator

import numpy as np

from jiti.episodes.episode import Problem
from jiti.episodes.lerobot_rows import EpisodeRows

TOLERANCE_FRAMES = 0.1
"""A timestamp may stand this far from its frame. Our choice: above float32's rounding in an hour at 60 Hz, below
what changes the frame."""

_SHIFTED = "The video and the numbers may not belong together at these frames: compare them, or record it again."
_CLOCK = "Frames are shown at the rate of info.json; correct fps or the timestamps."


def check_rows(rows: EpisodeRows, number: int, length: int, first_row: int | None, fps: float) -> Iterator[Problem]:
    """Yield what is wrong; rows that are only shuffled are put in the order of `frame_index`.

    `length` and `first_row` are what the table of contents says; None when it does not.
    """
    where = f"{rows.label}, episode {number}"
    if rows.count != length:
        what = f"it has {rows.count} rows; the table of contents says {length} frames"
        yield Problem(where, what, "The rows are used; correct meta/, or download the dataset again.", "error")
    yield from _check_order(rows, where)
    if "index" in rows.index:
        yield from _check_index(rows.index["index"], where, first_row)
    if "timestamp" in rows.index:
        yield from _check_times(rows.index["timestamp"], where, fps)
    else:
        yield Problem(where, "there is no column 'timestamp'", "Frames are shown at the rate of info.json.")


def _check_order(rows: EpisodeRows, where: str) -> Iterator[Problem]:
    if "frame_index" not in rows.index:
        yield Problem(where, "there is no column 'frame_index'", "Rows are taken in the order of the file.")
        return
    frames = rows.index["frame_index"]
    if np.array_equal(frames, np.arange(rows.count)):
        return
    wrong = int(np.flatnonzero(frames != np.arange(rows.count))[0])
    order = np.argsort(frames, kind="stable")
    if np.array_equal(frames[order], np.arange(rows.count)):
        rows.reorder(order)
        what = f"the rows are shuffled: row {wrong} is frame {frames[wrong]:.0f}"
        yield Problem(where, what, "They are shown in the order of frame_index; sort the file.")
        return
    what = f"frame_index does not count from 0 to {rows.count - 1}: row {wrong} has {frames[wrong]:g}"
    yield Problem(where, what, f"Rows are taken in the order of the file. {_SHIFTED}", "error")


def _check_index(index: np.ndarray, where: str, first_row: int | None) -> Iterator[Problem]:
    steps = np.diff(index)
    if (steps != 1).any():
        frame = int(np.flatnonzero(steps != 1)[0])
        what = f"index jumps from {index[frame]:.0f} to {index[frame + 1]:.0f} after frame {frame}"
        yield Problem(where, what, "Rows of other episodes may stand between; correct the file.")
    elif first_row is not None and index[0] != first_row:
        what = f"its rows begin at index {index[0]:.0f}; the table of contents says {first_row}"
        yield Problem(where, what, "The rows with its episode_index are used; correct meta/episodes.")


def _check_times(timestamp_s: np.ndarray, where: str, fps: float) -> Iterator[Problem]:
    missing = np.flatnonzero(~np.isfinite(timestamp_s))
    if len(missing):
        what = f"{len(missing)} timestamps are not numbers, the first at frame {missing[0]}"
        yield Problem(where, what, _CLOCK)
        return
    steps = np.diff(timestamp_s)
    for wrong, word in ((np.flatnonzero(steps < 0), "goes back"), (np.flatnonzero(steps == 0), "repeats")):
        if len(wrong):
            frame = int(wrong[0]) + 1
            what = f"the timestamp {word} at {len(wrong)} frames, first at frame {frame} ({timestamp_s[frame]:.3f} s)"
            yield Problem(where, what, _CLOCK)
    if (steps <= 0).any():
        return
    period_s = float(np.median(steps)) if len(steps) else 1 / fps
    if abs(period_s * fps - 1) > 0.01:
        what = f"timestamps run at {1 / period_s:.4g} Hz; info.json says {fps:g} Hz"
        yield Problem(where, what, _CLOCK)
        return
    off = np.abs(timestamp_s * fps - np.arange(len(timestamp_s)))
    if off.max() > TOLERANCE_FRAMES:
        frame = int(np.argmax(off > TOLERANCE_FRAMES))
        what = f"timestamps stand up to {off.max():.3g} frames from their frames, first at frame {frame}"
        yield Problem(where, f"{what} ({timestamp_s[frame]:.3f} s)", _CLOCK)
