"""Stage two: where in an episode each ITC is decided."""

from jiti.annotate.events import Events
from jiti.annotate.vlm.answers import Span, read_spans
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import Picture
from jiti.annotate.vlm.prompts import locate_prompt
from jiti.annotate.vlm.sampling import overview_frames
from jiti.annotate.vlm.sheets import contact_sheets
from jiti.episodes.episode import Episode
from jiti.tasks.task import ITC

type Views = list[tuple[str, list[Picture]]]
"""Name and contact sheets of each camera."""


def overview(episode: Episode, cameras: tuple[str, ...], events: Events) -> Views:
    """The whole episode, once for all its ITCs. Raises SourceError."""
    frames = overview_frames(episode.clock, events)
    return [(camera, contact_sheets(episode, camera, frames)) for camera in cameras]


def locate(asker: Asker, episode: Episode, instruction: str, itc: ITC, views: Views) -> list[Span]:
    """Raises ModelFailed."""
    duration_s = episode.clock.duration_ns / 1e9
    prompt = locate_prompt(instruction, itc, views)
    return asker.ask(prompt, lambda text: read_spans(text, duration_s)).value
