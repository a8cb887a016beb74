"""An episode that is to be played on an arm."""

from dataclasses import dataclass
from pathlib import Path

from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.plan import label_of


@dataclass(frozen=True, slots=True)
class Turn:
    """Which one, and how."""

    number: int
    """Of its recording."""
    seed: int
    """Of the noise that chunks are made from, and of the layout on a virtual table: alike for all guidances that are
    compared."""
    guidance: Guidance
    path: Path
    """The recording."""

    @property
    def label(self) -> str:
        """`none`, `jiti`, `full`, `jiti-random`."""
        return label_of(self.guidance)
