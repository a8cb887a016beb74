"""Stage two: where in an episode each ITC is decided."""

from dataclasses import dataclass

from jiti.annotate.events import Events
from jiti.annotate.vlm.answers import Span, read_spans
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import Picture
from jiti.annotate.vlm.prompts import locate_prompt
from jiti.annotate.vlm.sampling import overview_frames
from jiti.annotate.vlm.sheets import contact_sheets
from jiti.episodes.episode import Episode
from jiti.tasks.task import ITC


@dataclass(frozen=True, slots=True)
class Overview:
    """A whole episode: its cameras' contact sheets, by name, and when their frames are."""

    views: list[tuple[str, list[Picture]]]
    times_s: list[float]


def overview(episode: Episode, cameras: tuple[str, ...], events: Events) -> Overview:
    """The whole episode, once for all its ITCs. Raises SourceError."""
    frames = overview_frames(episode.clock, events)
    since_ns = episode.clock.frame_ns - episode.clock.frame_ns[0]
    views = [(camera, contact_sheets(episode, camera, frames)) for camera in cameras]
    return Overview(views, [float(since_ns[frame]) / 1e9 for frame in frames])


def locate(asker: Asker, episode: Episode, instruction: str, itc: ITC, shown: Overview) -> list[Span]:
    """Raises ModelFailed."""
    duration_s = episode.clock.duration_ns / 1e9
    prompt = locate_prompt(instruction, itc, shown.views, shown.times_s)
    return asker.ask(prompt, lambda text: read_spans(text, duration_s)).value
