"""Noise that a diffusion scheduler adds at its steps, made to depend on the chunk's own noise alone.

DDPM adds noise at every step, which the policy's noise at the start does not give. Each candidate gets a generator of
its own, seeded by the bytes of its noise, so that a chunk is the same in whatever batch it is drawn, and torch's
generator is left alone. DDIM, as lerobot sets it up, adds none.
"""

import hashlib

import torch  # noqa: TID253 - imported when a policy is opened
from torch import Tensor  # noqa: TID253


def generators(noise: Tensor) -> list[torch.Generator]:
    """One for each row of noise (n, K', A'), as diffusers' schedulers take them; on the CPU, whatever the device."""
    rows = noise.cpu().contiguous().numpy()
    return [
        torch.Generator().manual_seed(int.from_bytes(hashlib.sha256(row.tobytes()).digest()[:8]) >> 1) for row in rows
    ]
