"""Candidates of the multi-task diffusion transformer, whose view of the observations is computed once for all.

lerobot's `conditional_sample` draws its noise itself and takes none, so its loop over a scheduler's steps is written
out here; for flow matching its own integrators are asked.
"""

from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened
from torch import Tensor  # noqa: TID253

from jiti.runtime.candidates.history import stacked
from jiti.runtime.candidates.scheduled import generators


class MultiTaskDiTSource:
    """The two halves of lerobot's `MultiTaskDiTPolicy._generate_actions`; the horizon is cut as for `diffusion`."""

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self._config = config = policy.config
        self.history: int = config.n_obs_steps
        self.chunk: int = config.horizon - config.n_obs_steps + 1
        self.noise_shape = (config.horizon, config.action_feature.shape[0])

    def look(self, prepared: list[dict[str, Any]]) -> Tensor:
        """(1, C), what the network is conditioned on."""
        return self._policy.observation_encoder.encode(self._policy._prepare_batch(stacked(prepared)))

    def draw(self, looked: Tensor, noise: Tensor, actions: int) -> Tensor:
        seen = looked.expand(len(noise), -1)
        chunks = self._integrated(noise, seen) if self._config.is_flow_matching else self._denoised(noise, seen)
        return chunks[:, self.history - 1 :]

    def _integrated(self, noise: Tensor, seen: Tensor) -> Tensor:
        objective, network = self._policy.objective, self._policy.noise_predictor
        grid = torch.linspace(0, 1, self._config.num_integration_steps + 1, device=noise.device)
        integrate = {"euler": objective._euler_integrate, "rk4": objective._rk4_integrate}
        return integrate[self._config.integration_method](network, noise, grid, seen)

    def _denoised(self, noise: Tensor, seen: Tensor) -> Tensor:
        objective, network = self._policy.objective, self._policy.noise_predictor
        made: Any = generators(noise)
        objective.noise_scheduler.set_timesteps(objective.num_inference_steps)
        chunks = noise
        for time in objective.noise_scheduler.timesteps:
            at = torch.full((len(noise),), int(time), dtype=torch.long, device=noise.device)
            out = network(chunks, at, conditioning_vec=seen)
            chunks = objective.noise_scheduler.step(out, time, chunks, generator=made).prev_sample
        return chunks


def open_source(policy: Any) -> MultiTaskDiTSource:
    return MultiTaskDiTSource(policy)
