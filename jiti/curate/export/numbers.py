"""The numbers of one episode on the dataset's frames: held, checked, as float32."""

from collections.abc import Sequence

import numpy as np

from jiti.curate.export.features import Feature, columns_of
from jiti.curate.export.frames import Frames
from jiti.curate.export.scene import recorded_scene_state
from jiti.episodes.episode import Episode, samples
from jiti.errors import SourceError
from jiti.tasks.task import Task

LATE_S = 0.5
"""Frames before a stream's first sample show that one, up to this much. Our choice: no two streams start at once."""


def read_numbers(
    features: Sequence[Feature], episode: Episode, frames: Frames, task: Task | None, title: str
) -> dict[str, np.ndarray]:
    """(frames, size) float32 of each numeric feature, by key, in one pass over the recording.

    A frame has the latest sample at or before it. Raises SourceError that names recording, stream and frame where a
    number is missing or no number, and where a stream starts long after the first frame.
    """
    wanted = list(dict.fromkeys(name for feature in features for name in feature.streams))
    held = {name: _held(*read, name, frames, title) for name, read in samples(episode, wanted).items()}
    found: dict[str, np.ndarray] = {}
    for feature in features:
        if feature.scene_state:
            found[feature.key] = recorded_scene_state(episode, task, title)[frames.recorded]
        elif feature.streams:
            parts = [held[name][:, columns_of(feature, episode.streams[name], title)] for name in feature.streams]
            values = np.concatenate(parts, axis=1)
            _check(values, feature, episode, title)
            found[feature.key] = values.astype(np.float32)
    return found


def _held(time_ns: np.ndarray, values: np.ndarray, stream: str, frames: Frames, title: str) -> np.ndarray:
    """(frames, size): the latest sample at or before each frame; before the first, the first."""
    if not len(time_ns):
        raise SourceError(
            f"{title}, {stream}: no message of it can be read. Record the episode again, or leave it out with --filter."
        )
    late_s = (int(time_ns[0]) - int(frames.time_ns[0])) / 1e9
    if late_s > LATE_S:
        first = int(np.searchsorted(frames.time_ns, time_ns[0]))
        raise SourceError(
            f"{title}, {stream}: has nothing before frame {first} ({late_s:.2f} s after the first frame). "
            "Take another stream with --features, or leave the recording out with --filter."
        )
    return values[np.maximum(frames.hold(time_ns), 0)]


def _check(values: np.ndarray, feature: Feature, episode: Episode, title: str) -> None:
    """Raises SourceError that names the first frame and component that is not finite."""
    bad = np.argwhere(~np.isfinite(values))
    if not len(bad):
        return
    frame, column = (int(k) for k in bad[0])
    for stream in feature.streams:
        columns = columns_of(feature, episode.streams[stream], title)
        if column < len(columns):
            names = episode.streams[stream].names
            component = names[columns[column]] if names else f"component {columns[column]}"
            number = values[bad[0][0], bad[0][1]]
            more = f", and {len(bad) - 1} more" if len(bad) > 1 else ""
            raise SourceError(
                f"{title}, {stream}, frame {frame}: {component} is {number}{more}. Policies and critics cannot learn "
                f"from it: leave the recording out with --filter \"episode != '{episode.episode_id}'\", or the stream "
                "or component with --features."
            )
        column -= len(columns)
