"""What tells a stopped run that its inputs are still the same."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from jiti import __version__
from jiti.curate.export.features import Shape
from jiti.curate.export.planned import PlannedEpisode


def digest_of(episodes: Sequence[PlannedEpisode], shapes: Mapping[str, Shape], options: Sequence[Any]) -> str:
    """A hex digest that changes when anything does that the files of an episode are made of.

    `options` are those of the whole dataset, as JSON has them.
    """
    digest = hashlib.sha256()
    about = {key: value.to_info() for key, value in shapes.items()}
    digest.update(json.dumps([__version__, about, options], sort_keys=True).encode())
    for episode in episodes:
        told = {
            "from": [episode.source, episode.episode_id, episode.fingerprint],
            "instruction": episode.instruction,
            # Its goals as well: they decide where a thing stands in the scene's state.
            "task": asdict(episode.task) if episode.task else None,
            "success": episode.success,
            "split": episode.split,
            "segments": [[annotator, segment.to_row()] for annotator, segment in episode.segments],
            "features": [asdict(feature) for feature in episode.features],
        }
        digest.update(json.dumps(told, sort_keys=True).encode())
    return digest.hexdigest()
