"""The velocity of a flow from noise to a chunk of actions, given what is observed: an MLP with residual blocks."""

import torch  # noqa: TID253 - imported with the policy only
from torch import Tensor, nn  # noqa: TID253

from jiti.octaves import in_octaves

_TIME_FEATURES = 16
"""Frequencies in which the flow's time is seen. Our choice."""


class Block(nn.Module):
    """x + MLP(LayerNorm(x)), with zeros at the start so that depth does no harm early."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.first = nn.Linear(width, width)
        self.second = nn.Linear(width, width)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(nn.functional.silu(self.first(self.norm(x))))


class FlowNetwork(nn.Module):
    """v(A^tau, tau, s): observation (B, O) and task (B, T) are encoded once, and the chunk (B, K, A) at each step."""

    time_frequencies: Tensor

    def __init__(
        self, observed: int, tasks: int, chunk: int, actions: int, *, width: int, depth: int, frequencies: int
    ) -> None:
        super().__init__()
        self.chunk, self.actions, self.frequencies = chunk, actions, frequencies
        self.register_buffer("time_frequencies", torch.logspace(0, 2, _TIME_FEATURES), persistent=False)
        self.observation = nn.Linear(observed * (1 + 2 * frequencies), width)
        self.task = nn.Linear(tasks, width, bias=False)
        self.encoder = Block(width)
        self.flow = nn.Linear(chunk * actions + 2 * _TIME_FEATURES, width)
        self.blocks = nn.ModuleList(Block(width) for _ in range(depth))
        self.norm = nn.LayerNorm(width)
        self.velocity = nn.Linear(width, chunk * actions)
        nn.init.zeros_(self.velocity.weight)

    def encode(self, observed: Tensor, task: Tensor) -> Tensor:
        """(B, O), (B, T) -> (B, width)"""
        seen = self.observation(in_octaves(observed, self.frequencies))
        return self.encoder(nn.functional.silu(seen + self.task(task)))

    def forward(self, encoded: Tensor, noisy: Tensor, tau: Tensor) -> Tensor:
        """(B, width), (B, K, A), (B,) in 0 to 1 -> velocity (B, K, A)"""
        turns = tau.unsqueeze(-1) * self.time_frequencies
        x = encoded + self.flow(torch.cat([noisy.flatten(1), turns.sin(), turns.cos()], dim=-1))
        for block in self.blocks:
            x = block(x)
        return self.velocity(self.norm(x)).unflatten(-1, (self.chunk, self.actions))


def flow_loss(velocity: Tensor, actions: Tensor, noise: Tensor, valid: Tensor) -> Tensor:
    """|v(A^tau, s) - (A - eps)|^2 of each sample (B,), the mean over what is valid (B, K) of its chunk (B, K, A).

    The paper's base policy (main, flow matching), with A^tau = tau A + (1 - tau) eps.
    """
    error = (velocity - (actions - noise)).square().mean(-1) * valid
    return error.sum(-1) / valid.sum(-1).clamp_min(1)


def interpolate(actions: Tensor, noise: Tensor, tau: Tensor) -> Tensor:
    """A^tau = tau A + (1 - tau) eps: noise at 0, the actions at 1. (B, K, A), (B, K, A), (B,) -> (B, K, A)"""
    share = tau[:, None, None]
    return share * actions + (1 - share) * noise


def integrate(network: FlowNetwork, encoded: Tensor, noise: Tensor, steps: int) -> Tensor:
    """Chunks (B, K, A) from noise (B, K, A), in Euler steps of equal length."""
    chunk = noise
    for step in range(steps):
        tau = torch.full((len(noise),), step / steps, dtype=noise.dtype, device=noise.device)
        chunk = chunk + network(encoded, chunk, tau) / steps
    return chunk


def follow(average: nn.Module, network: nn.Module, decay: float) -> None:
    """Move an average of weights towards the network's: w_ema <- decay w_ema + (1 - decay) w."""
    with torch.no_grad():
        for mean, weight in zip(average.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - decay)


def ramped(decay: float, updates: int) -> float:
    """The decay after so many updates: short memory at the start, as in diffusion policies' public code."""
    return min(decay, (1 + updates) / (10 + updates))
