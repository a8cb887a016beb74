"""Chunks of a frozen policy for one observation, each made of the noise that is given for it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.critic.features.opened_policy import checkpoint_folder
from jiti.errors import UsageError
from jiti.runtime.candidates.observation import Observation, as_batch
from jiti.runtime.candidates.opened import OpenedBase, open_base
from jiti.runtime.candidates.source import KINDS, SharesFeatures, Source

if TYPE_CHECKING:
    import torch


@dataclass(eq=False, slots=True)
class Sampler:
    """A policy, and how it makes chunks of observations and noise."""

    base: OpenedBase
    source: Source
    first: int | None = None
    """Actions of a chunk that are made, its first; all where there is none. See `only`."""

    @property
    def noise_shape(self) -> tuple[int, int]:
        """(K', A') of the noise of one chunk; a policy may have more of both than its chunks."""
        return self.source.noise_shape

    @property
    def chunk(self) -> int:
        """K, actions of a chunk."""
        return min(self.first or self.source.chunk, self.source.chunk)

    @property
    def action(self) -> int:
        """A, numbers of an action."""
        return self.base.config.action_feature.shape[0]

    @property
    def executed(self) -> int:
        """Actions of a chunk that the policy means to be executed before the next decision; at most K."""
        return min(self.base.config.n_action_steps, self.chunk)

    def only(self, actions: int) -> "Sampler":
        """The same with chunks of their first `actions` actions, which are the same numbers. Some policies (SmolVLA) do
        not compute the others: what is executed, or valued if that is more, is enough. The noise keeps its shape."""
        return Sampler(self.base, self.source, actions)

    @property
    def history(self) -> int:
        """Observations that a decision looks at, the newest included, one a step."""
        return self.source.history

    def observe(self, observation: Observation, instruction: str, before: Sequence[Observation] = ()) -> "Seen":
        """What the policy sees now. A policy with a `history` gets the observations of the steps `before`, the oldest
        first; where there are fewer, the earliest stands for those that lack. Nothing is computed yet.

        Raises UsageError for an observation that lacks something, or of other sizes than the policy was trained with.
        """
        steps = [*before, observation][-self.history :]
        steps = [steps[0]] * (self.history - len(steps)) + steps
        batches = [self.base.renamed(as_batch(step, instruction)) for step in steps]
        return Seen(self, batches)


@dataclass(eq=False, slots=True)
class Seen:
    """One observation, ready for any number of chunks."""

    sampler: Sampler
    batches: list[dict[str, Any]]
    _looked: Any = field(init=False, default=None)

    def sample(self, noise: np.ndarray) -> np.ndarray:
        """Chunks (n, K, A) float32 in the robot's units from noise (n, K', A') float32, in one batch.

        Raises UsageError for noise of another shape.
        """
        import torch

        shape = self.sampler.noise_shape
        if noise.ndim != 3 or noise.shape[1:] != shape:
            raise UsageError(f"noise has the shape {noise.shape}; it must be {('n', *shape)} for n chunks.")
        with torch.inference_mode():
            looked = self.looked()
            given = torch.from_numpy(noise).to(self.sampler.base.config.device)
            chunks = self.sampler.source.draw(looked, given, self.sampler.chunk)
            return self.sampler.base.in_units(chunks[:, : self.sampler.chunk])

    def looked(self) -> Any:
        """What the policy makes of the observation before any noise; once."""
        import torch

        with torch.inference_mode():
            if self.sampler.base.prepared_for is not self or self._looked is None:
                prepared = [self.sampler.base.preprocess(dict(batch)) for batch in self.batches]
                self.sampler.base.prepared_for = self
                if self._looked is None:
                    self._looked = self.sampler.source.look(prepared)
            return self._looked

    def features(self, name: str) -> "torch.Tensor | None":
        """Features (1, T, D) of the extractor of a name, where they come from this policy's view of the observation."""
        source, (kind, _, argument) = self.sampler.source, name.partition(":")
        checkpoint, _, option = argument.partition("#")
        if not isinstance(source, SharesFeatures) or source.features_kind != kind:
            return None
        if checkpoint_folder(checkpoint).resolve() != self.sampler.base.folder.resolve():
            return None
        return source.features(self.looked(), option)


def open_sampler(policy: str | Path, device: str = "cpu") -> Sampler:
    """The sampler of a lerobot checkpoint's folder, of the newest of a run of `lerobot-train`, or of a Hub id.

    Raises UsageError for what is none, cannot be opened here, or gives one chunk only for an observation.
    """
    base = open_base(policy, device)
    return Sampler(base, import_module(KINDS[base.config.type]).open_source(base.policy))
