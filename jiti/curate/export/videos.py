"""The video of one camera of one episode: copied where it can be, else encoded."""

from dataclasses import dataclass
from pathlib import Path

from jiti.curate.export.codec import Codec
from jiti.curate.export.encode import encode_camera, picture_stats
from jiti.curate.export.frames import Frames
from jiti.curate.export.journal import DoneVideo
from jiti.curate.export.remux import copy_clip, describe, kind_of
from jiti.curate.export.stats import Stats
from jiti.episodes.episode import Episode
from jiti.episodes.lerobot_reader import LeRobotEpisode


@dataclass(frozen=True, slots=True)
class Camera:
    """What to make."""

    key: str
    """The feature."""
    stream: str
    size: tuple[int, ...]
    """(height, width) in the dataset."""
    path: Path


def make_video(
    episode: Episode, frames: Frames, fps: int, codec: Codec | None, title: str, camera: Camera
) -> tuple[DoneVideo, Stats, str]:
    """The video, statistics of its pictures, and why it was not copied if it might have been expected."""
    reason = _try_copy(episode, frames, codec, camera)
    if reason is None:
        stats = picture_stats(episode, camera.stream, frames.count)
        info = describe(camera.path, fps)
    else:
        height, width = camera.size
        chosen = codec or Codec()
        stats = encode_camera(episode, camera.stream, frames, (height, width), fps, chosen, camera.path, title)
        info = chosen.to_info(width, height, fps)
    note = f"{title}, {camera.stream}: encoded anew, because {reason}" if reason else ""
    return DoneVideo(camera.path.stat().st_size, kind_of(camera.path), info), stats, note


def _try_copy(episode: Episode, frames: Frames, codec: Codec | None, camera: Camera) -> str | None:
    """None when `camera.path` is there; else why not, and nothing where there is no video to copy."""
    if not isinstance(episode, LeRobotEpisode) or (clip := episode.clip(camera.stream)) is None:
        return ""
    if frames.resampled:
        return ""
    schema = episode.streams[camera.stream].schema
    if codec is not None and schema != f"video/{codec.name}":
        return ""
    if tuple(episode.streams[camera.stream].shape[:2]) != tuple(camera.size):
        return "its pictures have an odd size"
    return copy_clip(clip, camera.path)
