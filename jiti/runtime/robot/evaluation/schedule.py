"""Which guidance plays when: every layout of the table is played by each, in an order that nobody can guess."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Slot:
    """One episode of an evaluation."""

    number: int
    """From 0, in the order in which they are played, and of the recording."""
    layout: int
    """From 0: how the things lie, and the seed of the noise."""
    label: str


def schedule(labels: Sequence[str], layouts: int, salt: int) -> list[Slot]:
    """Layout after layout, as a person lays things out once for all guidances; within one, in an order that follows
    from `salt`. More layouts leave those before them as they are."""
    slots: list[Slot] = []
    for layout in range(layouts):
        order = np.random.default_rng([salt, layout]).permutation(len(labels))
        slots += [Slot(len(slots) + k, layout, labels[int(place)]) for k, place in enumerate(order)]
    return slots
