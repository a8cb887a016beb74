"""LeRobot's files, which hold many episodes each, joined from pieces of one episode each.

Where an episode goes follows from the sizes of the pieces alone, so that a run that was stopped finds the same places
again: a file that is there is whole, and the pieces of one that is not are still there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow.parquet as pq

from jiti.durable import replacing

CHUNK_FILES = 1000
DATA_FILE_BYTES = 100 << 20
VIDEO_FILE_BYTES = 200 << 20
"""Files in a folder and sizes of files: lerobot/datasets/utils.py, DEFAULT_CHUNK_SIZE and the two below it."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where an episode is."""

    chunk: int
    file: int
    frames_before: int
    """In the same file."""

    def path(self, template: str) -> str:
        """Inside the dataset."""
        return template.format(chunk_index=self.chunk, file_index=self.file)


@dataclass
class Places:
    """Gives each episode its file, in order."""

    limit_bytes: int
    _number: int = -1
    _bytes: int = 0
    _frames: int = 0
    _kind: str = ""

    def next(self, size_bytes: int, frames: int, kind: str = "") -> Place:
        """Of a piece of this size. Pieces of different kinds (videos of different codecs) are never in one file."""
        if self._number < 0 or self._bytes + size_bytes > self.limit_bytes or kind != self._kind:
            self._number, self._bytes, self._frames, self._kind = self._number + 1, 0, 0, kind
        place = Place(self._number // CHUNK_FILES, self._number % CHUNK_FILES, self._frames)
        self._bytes += size_bytes
        self._frames += frames
        return place


@dataclass
class Joiner:
    """Joins pieces into files as soon as a file is full, and removes them."""

    root: Path
    template: str
    """Of the file's place in the dataset."""
    limit_bytes: int
    join: Callable[[Sequence[Path], Path], None]
    _places: Places = field(init=False)
    _pending: list[Path] = field(default_factory=list)
    _place: Place | None = None

    def __post_init__(self) -> None:
        self._places = Places(self.limit_bytes)

    def add(self, piece: Path, size_bytes: int, frames: int, kind: str = "") -> Place:
        """Take the next piece, which need not be there any more where its file is."""
        place = self._places.next(size_bytes, frames, kind)
        if self._place is not None and place.frames_before == 0:
            self.close()
        self._pending.append(piece)
        self._place = place
        return place

    def close(self) -> None:
        """Write the file that is not full."""
        if self._place is None:
            return
        path = self.root / self._place.path(self.template)
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary:
                self.join(self._pending, temporary)
        for piece in self._pending:
            piece.unlink(missing_ok=True)
        self._pending, self._place = [], None


def join_tables(pieces: Sequence[Path], path: Path) -> None:
    """Parquet files into one, a row group each, as lerobot writes them."""
    schema = pq.read_schema(pieces[0])
    with pq.ParquetWriter(path, schema, compression="snappy", use_dictionary=True) as writer:
        for piece in pieces:
            writer.write_table(pq.ParquetFile(piece).read())
