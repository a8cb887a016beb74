"""Poses, contacts and openings of an episode on its frames, by the names of things."""

from functools import cached_property

import numpy as np

from jiti.annotate.channels import find_channels, is_place
from jiti.annotate.events import gripper_opening
from jiti.episodes.episode import Episode, Stream, samples
from jiti.tasks.rotation import matrices

GRIPPER = "gripper"
"""The hand, in the names of contacts: `gripper-bowl_1`."""
FIXTURES = "/fixtures/"
"""Under which a recording has how far the moving parts of things stand."""
_POSE = 7
"""Numbers of a pose: x, y, z in m, then a quaternion x, y, z, w."""


class Readings:
    """What was recorded under topics that end in a thing's name, and under `.../contacts` with pairs `a-b` as names.

    Frames before the first sample show the first. Everything is None that the recording does not have.
    """

    def __init__(self, episode: Episode) -> None:
        self.episode = episode
        self._poses: dict[str, str] = {}
        # An object's own place goes before what else may be called so.
        for stream in sorted(episode.streams.values(), key=lambda s: not s.name.startswith("/objects/")):
            if _is_pose(stream):
                self._poses.setdefault(stream.name.rpartition("/")[2], stream.name)
        self._contacts = {
            frozenset((a, b)): (stream.name, column)
            for stream in episode.streams.values()
            if stream.kind == "numeric" and stream.count > 0 and stream.name.rpartition("/")[2] == "contacts"
            for column, name in enumerate(stream.names)
            for a, _, b in (name.partition("-"),)
        }
        self._read: dict[str, np.ndarray] = {}

    @property
    def things(self) -> tuple[str, ...]:
        """Names that have a pose."""
        return tuple(self._poses)

    @property
    def frames(self) -> int:
        return self.episode.clock.frame_count

    @property
    def rate_hz(self) -> float:
        return self.episode.clock.rate_hz

    def position_m(self, name: str) -> np.ndarray | None:
        """(frames, 3)"""
        pose = self.pose(name)
        return None if pose is None else pose[:, :3]

    def rotation(self, name: str) -> np.ndarray | None:
        """(frames, 3, 3)"""
        pose = self.pose(name)
        # Who publishes positions only leaves the quaternion at 0.
        if pose is None or not np.linalg.norm(pose[:, 3:], axis=1).all():
            return None
        return matrices(pose[:, 3:])

    def touching(self, one: str, other: str) -> np.ndarray | None:
        """(frames,) bool; a region counts as the thing whose name it begins with."""
        place = self._contacts.get(frozenset((self.owner(one), self.owner(other))))
        if place is None:
            return None
        column = self._values(place[0])[:, place[1]]
        return column > 0.5 if np.isfinite(column).all() else None

    def owner(self, name: str) -> str:
        """The longest name of a thing with contacts that a name begins with, itself included."""
        known = {part for pair in self._contacts for part in pair}
        fitting = [part for part in known if name == part or name.startswith(f"{part}_")]
        return max(fitting, key=len, default=name)

    @cached_property
    def opening(self) -> np.ndarray | None:
        """(frames,): how open the gripper is, 0 to 1, by the first stream that shows it move; None for two arms."""
        channels = [c for c in find_channels(self.episode.streams) if c.role == "gripper"]
        if len({c.side for c in channels}) != 1:
            return None
        for channel in channels:
            opening = gripper_opening(channel, self._values(channel.stream)[:, channel.columns])
            if len(opening):
                return opening
        return None

    @cached_property
    def hand_m(self) -> np.ndarray | None:
        """(frames, 3): the end effector's place; None where there are several or none."""
        streams = self.episode.streams
        channels = [c for c in find_channels(streams) if c.role == "motion" and is_place(streams[c.stream], c)]
        if len({c.side for c in channels}) != 1:
            return None
        return self._values(channels[0].stream)[:, channels[0].columns]

    def pose(self, name: str) -> np.ndarray | None:
        """(frames, 7): x, y, z in m, then a quaternion x, y, z, w."""
        if name not in self._poses:
            return None
        values = self._values(self._poses[name])
        return values if np.isfinite(values).all() else None

    def joints(self, name: str) -> np.ndarray | None:
        """(frames, n) m or rad: how far the moving parts of a fixture stand; None where it has none."""
        stream = f"{FIXTURES}{name}"
        return self._values(stream) if stream in self.episode.streams else None

    def _values(self, stream: str) -> np.ndarray:
        """(frames, size) of a stream: the latest sample at or before each frame."""
        if not self._read:
            self._read = self._read_all()
        return self._read[stream]

    def _read_all(self) -> dict[str, np.ndarray]:
        """All streams that may be asked for, in one pass over the file."""
        wanted = {*self._poses.values(), *(stream for stream, _ in self._contacts.values())}
        wanted |= {c.stream for c in find_channels(self.episode.streams)}
        wanted |= {name for name in self.episode.streams if name.startswith(FIXTURES)}
        held: dict[str, np.ndarray] = {}
        for name, (time_ns, values) in samples(self.episode, sorted(wanted)).items():
            if len(time_ns):
                held[name] = values[np.maximum(self.episode.clock.hold(time_ns), 0)]
            else:
                held[name] = np.full((self.frames, *self.episode.streams[name].shape), np.nan)
        return held


def _is_pose(stream: Stream) -> bool:
    return (
        stream.kind == "numeric"
        and stream.shape == (_POSE,)
        and stream.count > 0
        and "Pose" in stream.schema + (stream.encoding)
    )
