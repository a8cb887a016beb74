"""Whether an episode succeeded, by what its recorder wrote."""

import json

import numpy as np

from jiti.episodes.episode import Episode, numbers
from jiti.episodes.mcap_episode import McapEpisode

OUTCOME = "outcome"
"""Key in the metadata of `jiti record`'s recordings under which the outcome stands, as JSON."""
SUCCESS = "next.success"
"""LeRobot's column: true at the last frame of an episode that succeeded."""


def recorded_success(episode: Episode) -> bool | None:
    """None where the recording does not say."""
    if isinstance(episode, McapEpisode):
        try:
            success = json.loads(episode.metadata.get(OUTCOME, "{}")).get("success")
        except (ValueError, AttributeError):
            return None
        return success if isinstance(success, bool) else None
    if SUCCESS in episode.streams and episode.streams[SUCCESS].kind == "numeric":
        _, values = numbers(episode, SUCCESS)
        return bool(np.nanmax(values) > 0) if len(values) else None
    return None
