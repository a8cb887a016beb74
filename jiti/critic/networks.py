"""Q over features and chunks of actions as an ensemble, and the actor. Sizes in, tensors out; no settings, no device.

Shapes: B states, T feature tokens of F numbers, N chunks a state, K actions of A numbers, E members.
"""

import math

import torch  # noqa: TID253  imported by training and evaluation only, which need torch
from torch import Tensor, nn  # noqa: TID253
from torch.nn import functional  # noqa: TID253

from jiti.octaves import in_octaves

LOG_STD_LEAST, LOG_STD_MOST = -5.0, 1.0
"""Limits of the actor's log standard deviation before tanh. Our choice, near those of SAC's authors (-20, 2)."""
FEATURE_LIMIT = 10.0
"""Normalized features are cut off here. Our choice: what hardly varied in training may be far off elsewhere."""


class Normalize(nn.Module):
    """Features (..., F) less the training data's mean, by its standard deviation; padding tokens stay zero."""

    mean: Tensor
    std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, features: Tensor) -> None:
        """Take mean and deviation of features (n, T, F); what does not vary is left at 0."""
        rows = features.flatten(0, 1).double()
        rows = rows[rows.abs().sum(1) > 0]
        std, mean = torch.std_mean(rows, 0, correction=0)
        self.mean.copy_(mean)
        self.std.copy_(torch.where(std > 1e-6 * (1 + mean.abs()), std, torch.inf))

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """(B, T, F) -> (B, T, F), and which tokens are no padding (B, T)."""
        there = features.abs().sum(-1) > 0
        scaled = ((features - self.mean) / self.std).clamp(-FEATURE_LIMIT, FEATURE_LIMIT)
        return scaled * there.unsqueeze(-1), there


class StackedLinear(nn.Module):
    """E linear layers side by side: (E, n, I) -> (E, n, O), or (n, I) -> (E, n, O)."""

    def __init__(self, members: int, inputs: int, outputs: int, *, scale: float = 1.0) -> None:
        super().__init__()
        bound = scale / math.sqrt(inputs)
        self.weight = nn.Parameter(torch.empty(members, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(members, 1, outputs))

    def forward(self, x: Tensor) -> Tensor:
        if x.dim() == 2:
            x = x.expand(len(self.weight), -1, -1)
        return torch.baddbmm(self.bias, x, self.weight)


class StackedNorm(nn.Module):
    """Layer norm with gains and offsets of each member: (E, n, W) -> (E, n, W)."""

    def __init__(self, members: int, width: int) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.ones(members, 1, width))
        self.offset = nn.Parameter(torch.zeros(members, 1, width))

    def forward(self, x: Tensor) -> Tensor:
        return functional.layer_norm(x, x.shape[-1:]) * self.gain + self.offset


class Block(nn.Module):
    """A pre-norm transformer block of each member, over sequences of L tokens."""

    def __init__(self, members: int, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = StackedNorm(members, width)
        self.query = StackedLinear(members, width, width)
        self.key_value = StackedLinear(members, width, 2 * width)
        self.out = StackedLinear(members, width, width)
        self.norm_wide = StackedNorm(members, width)
        self.wide = StackedLinear(members, width, 2 * width)
        self.narrow = StackedLinear(members, 2 * width, width)

    def forward(self, x: Tensor, there: Tensor, *, last_only: bool = False) -> Tensor:
        """(E, n, L, W) and keys that count (n, L) -> (E, n, L, W), or (E, n, 1, W) of the last token alone."""
        members, n, length, width = x.shape
        normed = self.norm(x.reshape(members, n * length, width))
        kept = x[:, :, -1:] if last_only else x
        asked = normed.view(members, n, length, width)[:, :, -1:].reshape(members, n, width) if last_only else normed
        query = self._split(self.query(asked), n)
        key, value = (self._split(part, n) for part in self.key_value(normed).chunk(2, -1))
        mask = there.repeat(members, 1)[:, None, None, :]
        seen = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        joined = seen.transpose(1, 2).reshape(members, -1, width)
        y = kept + self.out(joined).view_as(kept)
        wide = functional.gelu(self.wide(self.norm_wide(y.reshape(members, -1, width))))
        return y + self.narrow(wide).view_as(y)

    def _split(self, x: Tensor, n: int) -> Tensor:
        """(E, n * L, W) -> (E * n, heads, L, W / heads)."""
        members, rows, width = x.shape
        return x.reshape(members * n, rows // n, self.heads, width // self.heads).transpose(1, 2)


class Transformer(nn.Module):
    """The built-in trunk: members share nothing. The last token starts as the mean feature and sees all others."""

    def __init__(
        self, features: int, tokens: int, action: int, chunk: int, members: int, width: int, depth: int, heads: int
    ) -> None:
        super().__init__()
        self.members, self.width = members, width
        self.feature_in = StackedLinear(members, features, width)
        self.feature_out = StackedLinear(members, width, width)
        self.action_in = StackedLinear(members, action, width)
        self.place = nn.Parameter(torch.randn(members, 1, tokens + chunk + 1, width) * 0.02)
        self.blocks = nn.ModuleList(Block(members, width, heads) for _ in range(depth))
        self.norm = StackedNorm(members, width)

    def forward(self, features: Tensor, there: Tensor, chunks: Tensor, mask: Tensor) -> Tensor:
        """(B, T, F), (B, T), (B, N, K, A), (B, K) -> (E, B * N, W)."""
        members, width = self.members, self.width
        b, n, k, a = chunks.shape
        t = features.shape[1]
        seen = self.feature_out(functional.gelu(self.feature_in(features.reshape(b * t, -1))))
        seen = seen.view(members, b, t, width) * there[None, :, :, None]
        seen = seen.unsqueeze(2).expand(-1, -1, n, -1, -1).reshape(members, b * n, t, width)
        acts = self.action_in(chunks.reshape(b * n * k, a)).view(members, b * n, k, width)
        count = there.sum(1).clamp(min=1).repeat_interleave(n)[None, :, None, None]
        readout = seen.sum(2, keepdim=True) / count
        x = torch.cat([seen, acts, readout], 2) + self.place
        keys = torch.cat([there, mask, mask.new_ones(b, 1)], 1).repeat_interleave(n, 0)
        for number, block in enumerate(self.blocks, 1):
            x = block(x, keys, last_only=number == len(self.blocks))
        return self.norm(x[:, :, -1])


class QEnsemble(nn.Module):
    """Q of chunks: a trunk, and a head for each member. The trunk is the built-in one, or a Hugging Face backbone."""

    scale: Tensor

    def __init__(self, trunk: nn.Module, features: int, width: int, members: int, octaves: int = 0) -> None:
        """`trunk` takes features in so many octaves."""
        super().__init__()
        self.octaves = octaves
        self.normalize = Normalize(features)
        self.trunk = trunk
        self.hidden = StackedLinear(members, width, width)
        self.value = StackedLinear(members, width, 1, scale=0.1)
        self.register_buffer("scale", torch.ones(()))

    def forward(self, features: Tensor, chunks: Tensor, mask: Tensor) -> Tensor:
        """(B, T, F), (B, N, K, A) in -1 to 1, (B, K) -> (E, B, N). What `mask` leaves out has no influence.

        `scale` is the training returns' root mean square, so that the head's numbers are near 1. Our choice.
        """
        scaled, there = self.normalize(features)
        kept = chunks * mask[:, None, :, None]
        seen = self.trunk(in_octaves(scaled, self.octaves), there, kept, mask)
        hidden = functional.gelu(self.hidden(seen))
        return self.value(hidden).float().view(-1, *chunks.shape[:2]) * self.scale


class Actor(nn.Module):
    """pi(A|s): a Gaussian over all numbers of a chunk, through tanh into -1 to 1. Sees the mean of feature tokens."""

    def __init__(self, features: int, action: int, chunk: int, width: int) -> None:
        super().__init__()
        self.chunk, self.action = chunk, action
        self.normalize = Normalize(features)
        self.body = nn.Sequential(nn.Linear(features, width), nn.GELU(), nn.Linear(width, width), nn.GELU())
        self.out = nn.Linear(width, 2 * chunk * action)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """(B, T, F) -> mean and log standard deviation before tanh, (B, K, A) each."""
        scaled, there = self.normalize(features)
        pooled = scaled.sum(1) / there.sum(1, keepdim=True).clamp(min=1)
        mean, raw = self.out(self.body(pooled)).float().view(-1, 2, self.chunk, self.action).unbind(1)
        return mean, LOG_STD_LEAST + (LOG_STD_MOST - LOG_STD_LEAST) * (torch.tanh(raw) + 1) / 2

    def sample(self, features: Tensor, mask: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Chunks (B, N, K, A) and their log densities (B, N), of standard normal noise (B, N, K, A).

        Gradients pass through the chunks. Numbers that `mask` (B, K) leaves out are in no density.
        """
        mean, log_std = (part.unsqueeze(1) for part in self(features))
        before = mean + log_std.exp() * noise
        return torch.tanh(before), _log_density(before, mean, log_std, mask)

    def log_density(self, features: Tensor, chunks: Tensor, mask: Tensor) -> Tensor:
        """Log densities (B, N) of chunks (B, N, K, A) inside -1 to 1."""
        mean, log_std = (part.unsqueeze(1) for part in self(features))
        return _log_density(torch.atanh(chunks), mean, log_std, mask)


def _log_density(before: Tensor, mean: Tensor, log_std: Tensor, mask: Tensor) -> Tensor:
    """log N(u; mean, std) - log |d tanh(u) / du|, over what counts. The slope is in a form that stays above 0."""
    gauss = -0.5 * ((before - mean) / log_std.exp()) ** 2 - log_std - 0.5 * math.log(2 * math.pi)
    slope = 2 * (math.log(2) - before - functional.softplus(-2 * before))
    return ((gauss - slope) * mask[:, None, :, None]).sum((-1, -2))
