"""One episode of a dataset to be, before anything of it is written."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from jiti.annotate.segments import SCHEMA, Segment
from jiti.curate.export.features import Feature, Shape
from jiti.tasks.task import Task


@dataclass(frozen=True, slots=True)
class PlannedEpisode:
    """One episode of the dataset."""

    source: str
    episode_id: str
    """In its source."""
    title: str
    fingerprint: str
    instruction: str
    task: Task | None
    """As its source's catalogue has it; None for one that no catalogue has."""
    success: bool | None
    frames: int
    segments: tuple[tuple[str, Segment], ...]
    """Annotator and segment: those that count, on the dataset's frames."""
    reward: int | None
    first_return: float
    peak_return: float
    annotated: float
    verdicts: Mapping[str, int]
    """By ITC: 0 where any frame is violated."""
    features: tuple[Feature, ...]
    split: str = "train"
    index: int = -1
    first_frame: int = 0
    """In the whole dataset."""

    @property
    def task_id(self) -> str | None:
        return self.task.task_id if self.task else None

    def values(self, fps: int) -> dict[str, Any]:
        """What a filter asks for; see `filter.NAMES`."""
        return {
            "episode": self.episode_id,
            "source": self.source,
            "task": self.task_id,
            "instruction": self.instruction,
            "frames": self.frames,
            "seconds": self.frames / fps,
            "segments": len(self.segments),
            "annotators": ",".join(sorted({annotator for annotator, _ in self.segments})),
            "annotated": self.annotated,
            "reward": self.reward,
            "return": self.first_return,
            "peak_return": self.peak_return,
            "success": self.success,
            "split": self.split,
            "itc": self.verdicts,
        }


@dataclass(frozen=True, slots=True)
class Opened:
    """A planned episode and what is needed of its recording until the dataset is planned."""

    planned: PlannedEpisode
    shapes: Mapping[str, Shape]
    """By feature."""
    rate_hz: float

    @property
    def title(self) -> str:
        """For a message."""
        return f"{self.planned.source}, {self.planned.title}"


def segments_table(rows: Sequence[tuple[str, Segment]]) -> pa.Table:
    """What `read_segments` would give for these rows."""
    columns = [pa.array([getattr(segment, field.name) for _, segment in rows], field.type) for field in SCHEMA]
    annotators = pa.array([annotator for annotator, _ in rows], pa.string())
    return pa.Table.from_arrays([*columns, annotators], names=[*SCHEMA.names, "annotator"])
