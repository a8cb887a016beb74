"""`jiti curate --weights-from RUN`: what a critic thinks of each recorded chunk, as weights for `lerobot-train`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jiti.critic.critic import load_critic
from jiti.critic.dataset import read_elegant
from jiti.critic.features.cache import feature_cache
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


@dataclass(frozen=True, slots=True)
class Valued:
    """An episode of a dataset, as a critic sees it."""

    task: str
    q: np.ndarray
    """(frames,): of the chunk that was done at each frame."""
    reward: np.ndarray
    """(frames,). What is rewarded in an episode without a label is not known: both are zeros there."""

    @property
    def progress(self) -> np.ndarray:
        """(frames,) float32 for `lerobot-train`; without a label it stands still."""
        return value_progress(self.q, self.reward)


class Weigher:
    """The critic of a run, a folder or Hub id, that values the episodes of datasets. It is put where there is a GPU.

    It is loaded at once, so that one that is missing is told before a dataset is made for it. Raises SourceError for a
    critic or a dataset that cannot be read, or that do not fit each other.
    """

    def __init__(self, run: str | Path, *, features_dir: Path | None = None) -> None:
        self._device = str(usable_device("auto"))
        self._critic = load_critic(run, device=self._device)
        self._features = settings_from(self._critic.config["settings"]).data.features
        self._features_dir = features_dir

    def values(self, dataset: Path, progress: Progress) -> Iterator[Valued]:
        """Every episode, in order."""
        data = read_elegant(dataset)
        cache = feature_cache(data, self._features, folder=self._features_dir, device=self._device, progress=progress)
        check_sizes(self._critic, data, cache, UNWEIGHED)
        for episode in range(data.episodes):
            progress(episode / data.episodes, f"values of episode {episode}")
            frames = data.frames_of(np.array([episode]))
            if data.labelled[episode]:
                q, reward = recorded_values(self._critic, data, cache, frames), data.reward[frames]
            else:
                q, reward = np.zeros((2, len(frames)), np.float32)
            yield Valued(str(data.task[episode]), q, reward)

    def __call__(self, dataset: Path, progress: Progress) -> Path:
        """Write the weights into a dataset, and say where they are."""
        path = dataset / WEIGHTS_FILE
        write_weights(path, enumerate(found.progress for found in self.values(dataset, progress)))
        return path
