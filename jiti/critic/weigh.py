"""`jiti curate --weights-from RUN`: what a critic thinks of each recorded chunk, as weights for `lerobot-train`."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from jiti.critic.critic import Critic, load_critic
from jiti.critic.dataset import ElegantData, read_elegant
from jiti.critic.features.cache import FeatureCache, feature_cache
from jiti.critic.ranking import check_sizes, recorded_values
from jiti.critic.settings_file import settings_from
from jiti.critic.team import usable_device
from jiti.curate.export.weights import WEIGHTS_FILE, value_progress, write_weights
from jiti.progress import Progress

UNWEIGHED = (
    "The dataset is whole, without weights: take them from a critic of the same robot and features with "
    "`jiti curate DATASET --weights-from RUN`, or from labels with --weights."
)
"""What to do where a critic does not fit a dataset that was just made."""


def weigher(run: str | Path, *, features_dir: Path | None = None) -> Callable[[Path, Progress], Path]:
    """What writes the weights by the critic of a run, a folder or Hub id, into a dataset and says where they are.

    The critic is loaded here, so that one that is missing is told before a dataset is made for it. It is put where
    there is a GPU. Raises SourceError here for a critic, and there for a dataset, that cannot be read or does not fit.
    """
    device = str(usable_device("auto"))
    critic = load_critic(run, device=device)
    features = settings_from(critic.config["settings"]).data.features

    def weigh(dataset: Path, progress: Progress) -> Path:
        data = read_elegant(dataset)
        cache = feature_cache(data, features, folder=features_dir, device=device, progress=progress)
        check_sizes(critic, data, cache, UNWEIGHED)
        path = dataset / WEIGHTS_FILE
        write_weights(path, _progress_of(critic, data, cache, progress))
        return path

    return weigh


def _progress_of(
    critic: Critic, data: ElegantData, cache: FeatureCache, progress: Progress
) -> Iterator[tuple[int, np.ndarray]]:
    """Of every episode, in order. What is rewarded in one without a label is not known: there it stands still."""
    for episode in range(data.episodes):
        progress(episode / data.episodes, f"weights of episode {episode}")
        frames = data.frames_of(np.array([episode]))
        if data.labelled[episode]:
            yield episode, value_progress(recorded_values(critic, data, cache, frames), data.reward[frames])
        else:
            yield episode, np.zeros(len(frames), np.float32)
