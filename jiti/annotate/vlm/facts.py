"""What a recording's numbers say at the frames that a model is shown: gripper and end effector, as a small table."""

from collections.abc import Sequence

import numpy as np

from jiti.annotate.channels import Channel, find_channels, is_place
from jiti.annotate.events import gripper_opening
from jiti.episodes.episode import Episode, numbers
from jiti.tasks.task import Criterion

GEOMETRIC = (Criterion.TARGET_POSE_ACCURACY, Criterion.POSE_ALIGNMENT, Criterion.COLLISION_FREE_EXECUTION)
"""Criteria that ask where things are, on which pictures alone mislead: 47.8% right (supplement, G.2)."""


def fact_table(episode: Episode, frames: Sequence[int]) -> str:
    """Rows `time s | gripper open % | end effector x y z m`; empty where the recording has none of these."""
    channels = find_channels(episode.streams)
    grippers = [c for c in channels if c.role == "gripper"]
    hands = [c for c in channels if c.role == "motion" and is_place(episode.streams[c.stream], c)]
    columns: list[tuple[str, list[str]]] = []
    for channel in grippers:
        values = _at_frames(episode, channel, frames, opening=True)
        if values is not None:
            columns.append((f"{_side(channel)}gripper open %", [f"{100 * v[0]:.0f}" for v in values]))
    for channel in hands:
        values = _at_frames(episode, channel, frames, opening=False)
        if values is not None:
            shown = [" ".join(f"{x:.3f}" for x in v) for v in values]
            columns.append((f"{_side(channel)}end effector x y z, m", shown))
    if not columns:
        return ""
    since_ns = episode.clock.frame_ns - episode.clock.frame_ns[0]
    lines = [" | ".join(["time, s", *(name for name, _ in columns)])]
    for k, frame in enumerate(frames):
        lines.append(" | ".join([f"{since_ns[frame] / 1e9:.2f}", *(cells[k] for _, cells in columns)]))
    return "\n".join(lines)


def _at_frames(episode: Episode, channel: Channel, frames: Sequence[int], *, opening: bool) -> np.ndarray | None:
    """(frames, columns) of a channel, the latest sample at or before each frame; None when it has none or never moves.

    With `opening`, one column in 0 to 1.
    """
    time_ns, values = numbers(episode, channel.stream)
    good = np.isfinite(values[:, channel.columns]).all(axis=1)
    time_ns, signal = time_ns[good], values[good][:, channel.columns]
    if not len(signal):
        return None
    if opening:
        signal = gripper_opening(channel, signal)[:, None]
        if not len(signal):
            return None
    held = np.searchsorted(time_ns, episode.clock.frame_ns[list(frames)], side="right") - 1
    return signal[np.maximum(held, 0)]


def _side(channel: Channel) -> str:
    return f"{channel.side} " if channel.side else ""
