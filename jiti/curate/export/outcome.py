"""Whether an episode succeeded, by what its recorder wrote."""

import json

import numpy as np

from jiti.episodes.episode import Episode, NumericBatch
from jiti.episodes.mcap_episode import McapEpisode

OUTCOME = "outcome"
"""Key in the metadata of `jiti record`'s recordings (jiti/runtime/sim/record_episode.py)."""
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
        rows = [batch.values for batch in episode.read([SUCCESS]) if isinstance(batch, NumericBatch)]
        return bool(np.nanmax(np.concatenate(rows)) > 0) if rows else None
    return None
