"""A small D_elegant on which a critic learns in seconds, and torch on one thread."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.critic.elegant import Recorded, write_elegant


@pytest.fixture(autouse=True)
def one_thread():
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def toy_episode(rng: np.random.Generator, *, elegant: bool, task: str, split: str, frames: int = 40) -> Recorded:
    """A hand moves along x; frames 20 to 29 are decided: satisfied where the third action is held high there."""
    state = np.cumsum(rng.normal(0.05, 0.01, (frames, 3)), axis=0)
    action = rng.uniform(-0.2, 0.2, (frames, 3))
    action[18:32, 2] += 0.7 if elegant else -0.7
    annotated = np.zeros(frames, bool)
    annotated[20:30] = True
    return Recorded(state, action, annotated * float(elegant), annotated, task, split)


@pytest.fixture
def make_toy(tmp_path: Path) -> Callable[..., Path]:
    def make(name: str = "toy", **options) -> Path:
        rng = np.random.default_rng(5)
        splits = ["train"] * 12 + ["validation"] * 4 + ["test"] * 8
        episodes = [
            toy_episode(rng, elegant=n % 2 == 0, task=f"toy/{(n // 2) % 2}", split=split)
            for n, split in enumerate(splits)
        ]
        return write_elegant(tmp_path / name, episodes, **options)

    return make


@pytest.fixture
def toy(make_toy) -> Path:
    return make_toy()
