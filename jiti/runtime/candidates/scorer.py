"""Values of candidate chunks by a critic: the least of its members, on features that are computed once a decision."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.critic.features import FeatureExtractor, open_extractor
from jiti.errors import UsageError
from jiti.runtime.candidates.observation import PICTURES, Observation, as_batch, shapes_of
from jiti.runtime.candidates.sampler import Sampler, Seen
from jiti.runtime.guidance import Score

if TYPE_CHECKING:
    import torch

    from jiti.critic.critic import Critic


@dataclass(eq=False, slots=True)
class Scorer:
    """A critic, and how its features are made of observations."""

    critic: "Critic"
    features: str
    """The extractor's name, as it was trained with."""
    device: str
    _extractor: FeatureExtractor | None = field(init=False, default=None)

    @property
    def chunk(self) -> int:
        """K, actions of a chunk that are looked at, from its first on."""
        return self.critic.chunk

    def at(self, observation: Observation, instruction: str, seen: Seen | None = None) -> Score:
        """What values chunks (n, K, A) in the robot's units, of K actions or more, as (n,) float64.

        Features are computed when it is first called, and once; where they are in what the policy `seen` was asked for
        made of the observation, they are taken from there.
        """
        features: list[Any] = []

        def score(chunks: np.ndarray) -> np.ndarray:
            import torch

            with torch.inference_mode():
                if not features:
                    features.append(self._features(observation, instruction, seen))
                values = self.critic.values(features[0], chunks[None, :, : self.chunk])
                return values.min(0).values[0].double().cpu().numpy()

        return score

    def _features(self, observation: Observation, instruction: str, seen: Seen | None) -> "torch.Tensor":
        shared = seen.features(self.features) if seen is not None else None
        if shared is not None:
            return shared
        extractor = self.extractor(observation)
        return extractor.features(as_batch(observation, instruction))

    def extractor(self, observation: Observation) -> FeatureExtractor:
        """Opened at the first observation, whose sizes it needs. Raises UsageError where it does not fit."""
        if self._extractor is None:
            opened = open_extractor(self.features, shapes_of(observation), device=self.device)
            sizes = self.critic.sizes
            if (opened.tokens, opened.size) != (sizes.tokens, sizes.features):
                raise UsageError(
                    f"the critic takes features of {sizes.tokens} x {sizes.features} numbers, and {self.features} "
                    f"gives {opened.tokens} x {opened.size} here. Use the robot, scene and cameras of its dataset."
                )
            self._check_same(opened)
            self._extractor = opened
        return self._extractor

    def _check_same(self, opened: FeatureExtractor) -> None:
        """Raises UsageError where features are of other observations or weights than those that it learned from.

        The fingerprint of an extractor with pictures also has the names that a dataset gave them, which may be others
        here: of these nothing is said.
        """
        learned = self.critic.config.get("extractor", {}).get("fingerprint")
        if learned and learned != opened.fingerprint and not any(key.startswith(PICTURES) for key in opened.needs):
            raise UsageError(
                f"the critic learned from {self.features} of other observations or weights than there are here "
                f"({', '.join(opened.needs)}). Use the robot, scene and policy that it was trained with, or train it "
                "again."
            )


def open_scorer(critic: str | Path, device: str = "cpu") -> Scorer:
    """The scorer of a critic's folder or Hub id.

    Raises SourceError for what is no critic, UsageError where its features cannot be computed here.
    """
    from jiti.critic.critic import load_critic
    from jiti.critic.features.opened_policy import checkpoint_folder

    opened = load_critic(critic, device=device)
    name = str(opened.config.get("extractor", {}).get("name", "state"))
    kind, _, argument = name.partition(":")
    if kind != "state":
        checkpoint_folder(argument.partition("#")[0])
    return Scorer(opened, name, device)


def check_pair(sampler: Sampler, scorer: Scorer, observation: Observation | None = None) -> None:
    """Whether the critic can value the policy's chunks; with an observation, also whether it has features of it.

    Raises UsageError, which says what does not fit.
    """
    critic = scorer.critic
    if scorer.chunk > sampler.chunk:
        raise UsageError(
            f"the critic values chunks of {scorer.chunk} actions, and the policy gives {sampler.chunk}. Train the "
            f"critic with network.chunk={sampler.chunk} or less, or a policy of longer chunks."
        )
    if critic.sizes.action != sampler.action:
        raise UsageError(
            f"the critic values actions of {critic.sizes.action} numbers, and the policy's have {sampler.action}. "
            "Both must be of one robot."
        )
    if observation is not None:
        scorer.at(observation, "", sampler.observe(observation, ""))(np.zeros((1, scorer.chunk, sampler.action)))
