"""Pushes that a demonstrator did not mean and has to make good, so that a policy sees how one recovers.

As in DART (Laskey et al., 2017): what is executed is disturbed, what is recorded is what the demonstrator wanted. Who
learns from undisturbed demonstrations alone never sees where their own small errors take them.
"""

import numpy as np

PUSH_EVERY_STEPS = 39
"""Steps of 1/20 s from the beginning of a push to that of the next, on average; a push may follow another at once. Our
choice: mostly the hand comes to rest in between, so that what wants to be precise can be."""
PUSH_STEPS = 6
"""How long a push lasts. Our choice: at a strength of 0.3, it moves the hand by up to some 2 cm."""


class Disturbance:
    """Pushes that are added to the translation of actions (7,): each constant, in any direction, of a strength between
    0 and `strongest`, in the unit of an action. 0 changes nothing."""

    def __init__(self, strongest: float, random: np.random.Generator) -> None:
        self._strongest, self._random = strongest, random
        self._left, self._push = 0, np.zeros(3)

    def __call__(self, action: np.ndarray) -> np.ndarray:
        """The action (7,) as it is executed, its translation in -1 to 1."""
        if not self._strongest:
            return action
        if not self._left and self._random.random() < 1 / (PUSH_EVERY_STEPS - PUSH_STEPS + 1):
            self._left = PUSH_STEPS
            way = self._random.normal(size=3)
            self._push = way / np.linalg.norm(way) * self._random.uniform(0, self._strongest)
        if not self._left:
            return action
        self._left -= 1
        return np.concatenate([np.clip(action[:3] + self._push, -1, 1), action[3:]])
