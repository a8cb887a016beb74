"""Which stream of a recording becomes which feature of the dataset."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jiti.episodes.episode import Episode, Stream
from jiti.errors import SourceError, UsageError
from jiti.tasks.scene_state import scene_state_names

STATE = "observation.state"
ACTION = "action"
ENVIRONMENT_STATE = "observation.environment_state"
IMAGES = "observation.images."

DERIVED = {
    "next.reward": "float32",
    "next.done": "bool",
    "next.success": "bool",
    "elegance.annotated": "bool",
    "elegance.mc_return": "float32",
}
"""From the labels and the recorded outcome."""
INDEX = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Which row is which (lerobot/utils/constants.py, DEFAULT_FEATURES)."""
RESERVED = (*DERIVED, *INDEX)
"""Columns that are derived and not taken from a recording."""


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature and where it comes from: numeric streams, a camera, or the scene's state."""

    key: str
    """`observation.state`, `action`, `observation.images.front`."""
    streams: tuple[str, ...] = ()
    """Numeric streams whose components stand one behind the other."""
    components: tuple[str, ...] = ()
    """Names of the components that are taken, of a single stream; empty for all."""
    camera: str | None = None
    scene_state: bool = False
    """Where things are, by `jiti.tasks.scene_state`, of recordings of a simulator."""

    def __post_init__(self) -> None:
        if not self.key or "/" in self.key:
            # lerobot refuses a slash, because the key is a folder's name (lerobot/utils/feature_utils.py).
            raise UsageError(f"the feature name {self.key!r} is empty or has '/' in it; write {STATE!r} or the like.")
        if self.key in RESERVED:
            raise UsageError(f"the feature {self.key!r} is worked out from the labels; leave it out of the mapping.")
        if sum((bool(self.streams), self.camera is not None, self.scene_state)) != 1:
            raise UsageError(f"the feature {self.key!r} needs one of: streams, camera, scene_state = true.")
        if self.components and len(self.streams) != 1:
            raise UsageError(f"the feature {self.key!r} has components; that needs a single stream.")
        if self.camera is not None and not self.key.startswith(IMAGES):
            raise UsageError(f"the feature {self.key!r} is a camera; lerobot wants it to be called {IMAGES}NAME.")


@dataclass(frozen=True, slots=True)
class Shape:
    """What a feature looks like in the dataset; the same in every episode."""

    dtype: str
    """`float32` or `video`."""
    shape: tuple[int, ...]
    """(size,) for numbers, (height, width, 3) for pictures."""
    names: tuple[str, ...]
    """Of the components; empty where the recording has none."""

    def to_info(self) -> dict[str, Any]:
        """As info.json has it."""
        return {"dtype": self.dtype, "shape": list(self.shape), "names": list(self.names) or None}


PICTURE_NAMES = ("height", "width", "channels")


def shapes(features: Sequence[Feature], episode: Episode, title: str) -> dict[str, Shape]:
    """The shape of each feature in one recording. Raises SourceError for a stream that is not there."""
    return {feature.key: _shape(feature, episode, title) for feature in features}


def columns_of(feature: Feature, stream: Stream, title: str) -> list[int]:
    """Places of the components that a feature takes of a stream. Raises SourceError for one that is not there."""
    if not feature.components:
        return list(range(stream.shape[0]))
    places = {name: place for place, name in enumerate(stream.names)}
    for name in feature.components:
        if name not in places:
            known = ", ".join(stream.names) or "no names"
            raise SourceError(
                f"{title}, {stream.name}: has no component {name!r}, which {feature.key!r} takes; it has {known}. "
                "Correct the file of --features."
            )
    return [places[name] for name in feature.components]


def _shape(feature: Feature, episode: Episode, title: str) -> Shape:
    if feature.scene_state:
        return Shape("float32", (len(scene_state_names()),), scene_state_names())
    if feature.camera is not None:
        stream = _stream(feature, feature.camera, "camera", episode, title)
        if len(stream.shape) < 2 or not all(stream.shape[:2]):
            raise SourceError(
                f"{title}, {stream.name}: does not say how large its pictures are. Leave this camera out."
            )
        height, width = (max(2, size & ~1) for size in stream.shape[:2])  # 4:2:0 needs even numbers
        return Shape("video", (height, width, 3), PICTURE_NAMES)
    names: list[str] = []
    size = 0
    named = True
    for name in feature.streams:
        stream = _stream(feature, name, "numeric", episode, title)
        columns = columns_of(feature, stream, title)
        size += len(columns)
        named &= bool(stream.names)
        names += [stream.names[k] for k in columns] if stream.names else []
    return Shape("float32", (size,), tuple(names) if named else ())


def _stream(feature: Feature, name: str, kind: str, episode: Episode, title: str) -> Stream:
    stream = episode.streams.get(name)
    wanted = "camera" if kind == "camera" else "stream of numbers"
    if stream is None or stream.kind != kind or stream.count == 0:
        there = ", ".join(s.name for s in episode.streams.values() if s.kind == kind and s.count) or "none"
        what = f"is no {wanted}" if stream is not None else f"is not there: no {wanted}"
        raise SourceError(
            f"{title}: {name!r} {what} for {feature.key!r}; it has: {there}. "
            "Write another mapping with --features (--print-features shows one to begin from), or leave the recording "
            "out with --filter."
        )
    return stream
