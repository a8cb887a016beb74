"""Where a chunk of actions would take the hand: near enough to be drawn, no prediction."""

import numpy as np

from jiti.runtime.sim.scene import STEP_M

FOLLOWED = 0.25
"""Share of a commanded displacement that the arm makes before the next command. OSC starts each goal at the hand where
it is, so commands do not add up in full. Measured on demonstrations of T0, T2 and T5 (0.24 to 0.25): after ten steps,
paths end within a centimetre of where the hand came to be."""


def chunk_path(hand_m: np.ndarray, chunks: np.ndarray) -> np.ndarray:
    """(n, K + 1, 3) m: places of the hand, from where it is (3,), if it follows each of the chunks (n, K, 7), whose
    actions are executed clipped to -1 to 1."""
    moved = np.cumsum(np.clip(chunks[..., :3], -1, 1) * STEP_M * FOLLOWED, axis=1)
    return hand_m + np.concatenate([np.zeros((len(chunks), 1, 3)), moved], axis=1)
