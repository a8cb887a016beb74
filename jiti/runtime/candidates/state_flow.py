"""Candidates of our own policy, which takes noise (B, N, K, A) and encodes an observation once for all N."""

from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened


class StateFlowSource:
    """`StateFlowPolicy.predict_action_chunk` with its noise. Its encoder, one small layer, runs with each draw."""

    history = 1

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self.chunk: int = policy.config.chunk_size
        self.noise_shape = (self.chunk, policy.config.action_feature.shape[0])

    def look(self, prepared: list[dict[str, Any]]) -> dict[str, Any]:
        return prepared[-1]

    def draw(self, looked: dict[str, Any], noise: torch.Tensor, actions: int) -> torch.Tensor:
        return self._policy.predict_action_chunk(looked, noise.unsqueeze(0))[0]


def open_source(policy: Any) -> StateFlowSource:
    return StateFlowSource(policy)
