"""Numbers in octaves, so that a network that sees places all over a scene tells millimetres apart as well."""

import torch  # noqa: TID253  imported by networks only
from torch import Tensor  # noqa: TID253


def in_octaves(x: Tensor, octaves: int) -> Tensor:
    """(..., F) -> (..., F + 2 F octaves): x, then the sines of 2 x, 4 x, 8 x, ..., then their cosines."""
    turns = (x.unsqueeze(-1) * 2.0 ** torch.arange(1, octaves + 1, device=x.device)).flatten(-2)
    return torch.cat([x, turns.sin(), turns.cos()], dim=-1)
