"""The mapping that needs no file: features by what a recording's streams are called and hold."""

import re
from collections.abc import Iterable

from jiti.annotate.simulator import has_trace
from jiti.curate.export.features import ACTION, ENVIRONMENT_STATE, IMAGES, RESERVED, STATE, Feature
from jiti.episodes.episode import Episode, Stream
from jiti.episodes.lerobot_reader import LeRobotEpisode
from jiti.errors import SourceError

_ACTION_NAMES = ("action", "actions", "command", "commands", "joint_commands", "joint_command", "target", "targets")
"""Last parts of topics that say what the robot was told, the likeliest first. Our choice: what drivers call them."""
_STATE_NAMES = ("proprio", "state", "joint_states", "joint_state", "joints", "joint_positions", "robot_state")
"""Last parts of topics that say how the robot is, the likeliest first. Our choice; `proprio` is what LIBERO takes."""
_TRANSPORT = {
    "image", "image_raw", "image_rect", "compressed", "color", "rgb", "camera", "cameras", "raw", "video", "h264",
}  # fmt: skip
"""Parts of a camera's topic that say how and not which. Our choice, from ROS 2's image transports."""
_POSITION = ".position"
"""End of the names of components of joint states that are positions; velocities and efforts are left out."""


def map_automatically(episode: Episode, title: str) -> tuple[Feature, ...]:
    """Features of one recording. Raises SourceError that lists its streams when it has no state or no action."""
    if isinstance(episode, LeRobotEpisode):
        return _of_lerobot(episode, title)
    numeric = [s for s in episode.streams.values() if s.kind == "numeric" and s.count]
    found = [_state(numeric, episode, title), _numbers(ACTION, numeric, _ACTION_NAMES, episode, title)]
    if has_trace(episode) and "/eef_pose" in episode.streams:
        found.append(Feature(ENVIRONMENT_STATE, scene_state=True))
    return (*found, *_cameras(s.name for s in episode.streams.values() if s.kind == "camera" and s.count))


def _of_lerobot(episode: Episode, title: str) -> tuple[Feature, ...]:
    """A dataset's own features under their own names."""
    found: list[Feature] = []
    for stream in episode.streams.values():
        if stream.kind == "camera" and stream.count:
            name = stream.name.removeprefix(IMAGES).replace("/", "_")
            found.append(Feature(IMAGES + name, camera=stream.name))
        elif stream.kind == "numeric" and stream.name not in RESERVED:
            found.append(Feature(stream.name, (stream.name,)))
    if not any(feature.key == ACTION for feature in found):
        raise _lacks(ACTION, episode, title)
    return tuple(found)


def _state(numeric: list[Stream], episode: Episode, title: str) -> Feature:
    feature = _numbers(STATE, numeric, _STATE_NAMES, episode, title)
    names = episode.streams[feature.streams[0]].names
    positions = tuple(name for name in names if name.endswith(_POSITION))
    return Feature(STATE, feature.streams, positions if len(positions) < len(names) else ())


def _numbers(key: str, numeric: list[Stream], endings: tuple[str, ...], episode: Episode, title: str) -> Feature:
    last = {s.name: re.split(r"[/.]", s.name.strip("/"))[-1].lower() for s in numeric}
    for ending in endings:
        if found := [s.name for s in numeric if last[s.name] == ending]:
            # Two arms: all of them, in the recording's order.
            return Feature(key, tuple(found))
    raise _lacks(key, episode, title)


def _lacks(key: str, episode: Episode, title: str) -> SourceError:
    numeric = ", ".join(s.name for s in episode.streams.values() if s.kind == "numeric" and s.count) or "none"
    return SourceError(
        f"{title}: no stream is called what {key!r} is usually called; streams of numbers are: {numeric}. "
        "Say which one it is in a file: --print-features > features.toml, then --features features.toml."
    )


def _cameras(topics: Iterable[str]) -> list[Feature]:
    """`/camera/front/image_raw` becomes `observation.images.front`; all parts tell names apart that meet."""
    names: dict[str, str] = {}
    for topic in topics:
        parts = [p for p in re.split(r"[^A-Za-z0-9]*/[^A-Za-z0-9]*", topic.strip("/")) if p]
        telling = [p for p in parts if p.lower() not in _TRANSPORT] or parts[-1:]
        name = telling[-1]
        names[topic] = name if name not in names.values() else "_".join(parts)
    return [Feature(IMAGES + re.sub(r"[^\w-]", "_", name), camera=topic) for topic, name in names.items()]
