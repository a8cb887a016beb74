"""What tells a stopped run that its inputs are still the same."""

import hashlib
import json
from collections.abc import Mapping, Sequence

from jiti.curate.export.features import Shape
from jiti.curate.export.planned import PlannedEpisode


def digest_of(
    episodes: Sequence[PlannedEpisode], shapes: Mapping[str, Shape], fps: int, gamma: float, rule: str
) -> str:
    """A hex digest that changes when anything does that the files of an episode are made of."""
    digest = hashlib.sha256()
    about = {key: value.to_info() for key, value in shapes.items()}
    digest.update(json.dumps([about, fps, gamma, rule], sort_keys=True).encode())
    for episode in episodes:
        rows = [[annotator, segment.to_row()] for annotator, segment in episode.segments]
        mapping = [[f.key, f.streams, f.components, f.camera, f.scene_state] for f in episode.features]
        told = [episode.source, episode.episode_id, episode.fingerprint, episode.split, episode.task_id, rows, mapping]
        digest.update(json.dumps(told, sort_keys=True).encode())
    return digest.hexdigest()
