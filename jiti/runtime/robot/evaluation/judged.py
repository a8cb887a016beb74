"""`evaluation.parquet`: what was played and how it was judged, a row an episode, with what all of it shares."""

import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jiti.durable import replacing
from jiti.errors import SourceError, UsageError

FILE = "evaluation.parquet"
SCHEMA = pa.schema(
    [
        pa.field("number", pa.int64(), nullable=False),
        pa.field("task", pa.string(), nullable=False),
        pa.field("layout", pa.int64(), nullable=False),
        pa.field("guidance", pa.string(), nullable=False),
        pa.field("recording", pa.string(), nullable=False),
        pa.field("ended", pa.string(), nullable=False),
        pa.field("success", pa.bool_()),
        pa.field("itcs", pa.map_(pa.string(), pa.bool_())),
        pa.field("annotator", pa.string()),
        pa.field("recorded_at", pa.int64(), nullable=False),
        pa.field("judged_at", pa.int64()),
    ]
)
"""`itcs` has what a person could tell; times are nanoseconds since 1970, UTC."""
_KEY = b"jiti"


@dataclass(frozen=True, slots=True)
class Judged:
    """An episode that was played; judged where `success` is not None."""

    number: int
    task: str
    layout: int
    guidance: str
    recording: str
    """File name."""
    ended: str
    recorded_at: int
    success: bool | None = None
    itcs: Mapping[str, bool | None] = field(default_factory=dict)
    """None where the person could not tell."""
    annotator: str | None = None
    judged_at: int | None = None

    @property
    def label(self) -> str:
        return self.guidance

    @property
    def seed(self) -> int:
        return self.layout

    @property
    def elegant(self) -> bool:
        """Successful, and no ITC violated or left open."""
        return bool(self.success) and all(self.itcs.values())


@dataclass(frozen=True)
class Kept:
    """The file, as it is on the disk."""

    path: Path
    settings: Mapping[str, Any]
    """What all episodes share."""
    salt: int
    """Of the order."""
    planned: int
    """Episodes in all."""
    rows: tuple[Judged, ...] = ()
    """By number."""

    @property
    def whole(self) -> bool:
        """Whether all that was planned is judged."""
        return len(self.rows) >= self.planned and not self.waiting

    @property
    def waiting(self) -> list[Judged]:
        """Those that were played and are not judged."""
        return [row for row in self.rows if row.success is None]

    def with_row(self, row: Judged) -> "Kept":
        """With a row in the place of the one with its number, on the disk. Raises SaveFailed."""
        rows = {r.number: r for r in self.rows} | {row.number: row}
        kept = replace(self, rows=tuple(rows[number] for number in sorted(rows)))
        kept.save()
        return kept

    def save(self) -> None:
        """Raises SaveFailed."""
        columns = {name: [getattr(row, name) for row in self.rows] for name in SCHEMA.names}
        columns["itcs"] = [list(row.itcs.items()) for row in self.rows]
        about = json.dumps({"settings": self.settings, "salt": self.salt, "planned": self.planned})
        with replacing(self.path) as temporary:
            pq.write_table(pa.table(columns, schema=SCHEMA.with_metadata({_KEY: about})), temporary)


def open_kept(folder: Path, settings: Mapping[str, Any], planned: int) -> Kept:
    """What is in a folder, or a new one; of the two plans the longer one counts. Raises UsageError where it was begun
    otherwise, SourceError for damage."""
    path = folder / FILE
    if not path.exists():
        return Kept(path, settings, secrets.randbits(63), planned)
    kept = read_kept(path)
    for name, value in _flat(settings).items():
        before = _flat(kept.settings).get(name)
        if before != value:
            raise UsageError(
                f"{folder} holds an evaluation with {name} {before} and not {value}; one that mixes both would compare "
                "nothing. Pass what it was begun with, or another --out."
            )
    return replace(kept, planned=max(planned, kept.planned))


def _flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """`guidance jiti tau` for what is in one another."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        inner = _flat(value) if isinstance(value, Mapping) else {"": value}
        flat |= {f"{name} {key}".strip(): one for key, one in inner.items()}
    return flat


def read_kept(path: Path) -> Kept:
    """Raises SourceError for a file of something else."""
    try:
        table = pq.read_table(path)
        about = json.loads((table.schema.metadata or {})[_KEY])
        rows = table.select(SCHEMA.names).cast(SCHEMA).to_pylist()
        return Kept(path, about["settings"], about["salt"], about["planned"], tuple(_judged(row) for row in rows))
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as error:
        raise SourceError(
            f"{path} is damaged, or not of an evaluation: {error}. Move it away; the recordings beside it are whole."
        ) from error


def _judged(row: dict[str, Any]) -> Judged:
    values: dict[str, Any] = row | {"itcs": dict(row["itcs"] or ())}
    return Judged(**values)
