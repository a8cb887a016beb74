"""A segment: frames where an ITC is decided, and how it was decided there. One row of the label store."""

import os
import time
import uuid
from dataclasses import dataclass, fields, replace
from operator import index
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from jiti.errors import LabelError

SCHEMA_VERSION = 1

Status = Literal["proposed", "accepted", "rejected"]
Source = Literal["human", "vlm", "signal", "sim"]

DEFAULT_WINDOW_FRAMES = 25
"""Length of a segment that is marked with one key. 25-frame windows, main paper."""

SCHEMA = pa.schema(
    [
        pa.field("segment_id", pa.string(), nullable=False),
        pa.field("episode_id", pa.string(), nullable=False),
        pa.field("itc_id", pa.string(), nullable=False),
        pa.field("criterion", pa.string(), nullable=False),
        pa.field("start_frame", pa.int64(), nullable=False),
        pa.field("end_frame", pa.int64(), nullable=False),
        pa.field("start_ns", pa.int64(), nullable=False),
        pa.field("end_ns", pa.int64(), nullable=False),
        pa.field("reward", pa.int8()),
        pa.field("status", pa.string(), nullable=False),
        pa.field("source", pa.string(), nullable=False),
        pa.field("confidence", pa.float64()),
        pa.field("rationale", pa.string()),
        pa.field("parent_id", pa.string()),
        pa.field("created_at", pa.int64(), nullable=False),
        pa.field("updated_at", pa.int64(), nullable=False),
    ]
)
"""Columns of a segments file; `created_at` and `updated_at` are nanoseconds since 1970, UTC."""


_WHOLE = ("start_frame", "end_frame", "start_ns", "end_ns", "reward", "created_at", "updated_at")
_TEXT = ("segment_id", "episode_id", "itc_id", "criterion", "rationale", "parent_id")


@dataclass(frozen=True, slots=True)
class Segment:
    """Frames `start_frame` to `end_frame`, both inclusive (supplement B.3), with a binary verdict."""

    segment_id: str
    episode_id: str
    itc_id: str
    criterion: str
    start_frame: int
    end_frame: int
    start_ns: int
    end_ns: int
    """Times of the two frames in the recording's clock."""
    reward: int | None = None
    """1 satisfied, 0 violated, None undecided."""
    status: Status = "accepted"
    source: Source = "human"
    confidence: float | None = None
    """Of the verdict, in 0 to 1; None for people."""
    rationale: str | None = None
    """Why: a model's words, or an annotator's note."""
    parent_id: str | None = None
    """The proposal that this row decides on."""
    created_at: int = 0
    updated_at: int = 0

    def __post_init__(self) -> None:
        self._check_types()
        for field, value, allowed in (
            ("reward", self.reward, (None, 0, 1)),
            ("status", self.status, ("proposed", "accepted", "rejected")),
            ("source", self.source, ("human", "vlm", "signal", "sim")),
        ):
            if value not in allowed:
                raise LabelError(f"segment {self.segment_id}: {field} is {value!r}; it must be one of {allowed}")
        if not 0 <= self.start_frame <= self.end_frame:
            raise LabelError(
                f"segment {self.segment_id} runs from frame {self.start_frame} to {self.end_frame}; "
                "the start must be 0 or more and not after the end"
            )
        if self.confidence is not None and not 0 <= self.confidence <= 1:
            raise LabelError(f"segment {self.segment_id}: confidence is {self.confidence}; it must be in 0 to 1")

    def _check_types(self) -> None:
        """What the store could not write is refused here; NumPy's numbers become Python's."""
        for name in _WHOLE:
            if name == "reward" and self.reward is None:
                continue
            value: Any = getattr(self, name)
            try:
                plain = index(value)
            except TypeError:
                raise LabelError(f"segment {self.segment_id}: {name} is {value!r}; it must be a whole number") from None
            if not -(1 << 63) <= plain < 1 << 63:
                raise LabelError(f"segment {self.segment_id}: {name} is {value!r}; it must fit into 64 bits")
            if plain is not value:
                object.__setattr__(self, name, plain)
        for name in _TEXT:
            value = getattr(self, name)
            if value is None and name in ("rationale", "parent_id"):
                continue
            if not isinstance(value, str) or (not value.isascii() and _has_surrogates(value)):
                raise LabelError(f"segment {self.segment_id!r}: {name} is {value!r}; it must be a text")
        if self.confidence is not None:
            if not isinstance(self.confidence, int | float | np.floating):
                raise LabelError(f"segment {self.segment_id}: confidence is {self.confidence!r}; it must be a number")
            object.__setattr__(self, "confidence", float(self.confidence))

    @property
    def frame_count(self) -> int:
        return self.end_frame - self.start_frame + 1

    def to_row(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in SCHEMA.names}

    @classmethod
    def from_row(cls, row: dict[str, Any]) -> "Segment":
        """From a row or a JSON object. Raises LabelError for a field that is missing, unknown or of a wrong type."""
        known = {f.name for f in fields(cls)}
        if unknown := set(row) - known:
            raise LabelError(f"a segment has no field {sorted(unknown)[0]!r}; it has: {', '.join(sorted(known))}")
        for name in ("start_frame", "end_frame", "start_ns", "end_ns"):
            if not isinstance(row.get(name), int) or isinstance(row[name], bool):
                raise LabelError(f"segment field {name} is {row.get(name)!r}; it must be a whole number")
        if isinstance(row.get("reward"), bool):
            raise LabelError(f"segment field reward is {row['reward']!r}; it must be 0, 1 or null")
        for name in ("segment_id", "episode_id", "itc_id", "criterion"):
            if not isinstance(row.get(name), str) or not row[name]:
                raise LabelError(f"segment field {name} is {row.get(name)!r}; it must be a text that is not empty")
        return cls(**row)

    def changed(self, **changes: Any) -> "Segment":
        """A copy with the changes and a new `updated_at`."""
        return replace(self, **changes, updated_at=time.time_ns())


def _has_surrogates(text: str) -> bool:
    """Half of a character pair, which JSON can carry and UTF-8 cannot."""
    return any("\ud800" <= character <= "\udfff" for character in text)


def new_segment_id() -> str:
    """A UUIDv7 (RFC 9562): 48 bits of milliseconds, then random bits, so that ids sort by creation."""
    value = (time.time_ns() // 1_000_000 & (1 << 48) - 1) << 80 | int.from_bytes(os.urandom(10))
    value = value & ~(0xF << 76) | 0x7 << 76
    value = value & ~(0x3 << 62) | 0x2 << 62
    return str(uuid.UUID(int=value))
