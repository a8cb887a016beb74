"""Candidates of Diffusion Policy, which takes noise, and whose view of the observations is computed once for all."""

from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened
from torch import Tensor  # noqa: TID253

from jiti.runtime.candidates.history import stacked
from jiti.runtime.candidates.scheduled import generators


class DiffusionSource:
    """The two halves of lerobot's `DiffusionModel.generate_actions`.

    Of the horizon, what lies before now is cut off, and what lies behind the actions that are meant to be executed is
    kept: the policy learned it as well.
    """

    def __init__(self, policy: Any) -> None:
        config = policy.config
        self._config = config
        self._model = policy.diffusion
        self.history: int = config.n_obs_steps
        self.chunk: int = config.horizon - config.n_obs_steps + 1
        self.noise_shape = (config.horizon, config.action_feature.shape[0])

    def look(self, prepared: list[dict[str, Any]]) -> Tensor:
        """(1, C), what the network is conditioned on."""
        seen = stacked(prepared)
        if self._config.image_features:
            seen["observation.images"] = torch.stack([seen[key] for key in self._config.image_features], dim=-4)
        return self._model._prepare_global_conditioning(seen)

    def draw(self, looked: Tensor, noise: Tensor, actions: int) -> Tensor:
        n = len(noise)
        made: Any = generators(noise)
        chunks = self._model.conditional_sample(n, global_cond=looked.expand(n, -1), generator=made, noise=noise)
        return chunks[:, self.history - 1 :]


def open_source(policy: Any) -> DiffusionSource:
    return DiffusionSource(policy)
