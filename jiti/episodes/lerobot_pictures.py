"""Pictures of a LeRobot episode: of a video file, or of a column of a data file."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import av
import numpy as np

from jiti.episodes.episode import ImageBatch, Problem, Stream
from jiti.episodes.lerobot_depth import CODE_FORMATS, DepthCode, read_depth_clip, tiff_to_png16
from jiti.episodes.lerobot_info import DatasetInfo, Feature
from jiti.episodes.lerobot_rows import EpisodeRows
from jiti.episodes.video_clip import BATCH_FRAMES, Clip, decode_clip, in_batches, read_clip, scan_clip
from jiti.errors import SourceError

Report = Callable[[Problem], None]

_MAGIC = ((b"\x89PNG\r\n\x1a\n", "png"), (b"\xff\xd8\xff", "jpeg"), (b"II*\0", "tiff"), (b"MM\0*", "tiff"))


class Pictures(Protocol):
    """One camera of one episode."""

    stream: Stream
    max_bytes: int
    """Upper bound of the encoded pictures."""

    def read(self, frame_ns: np.ndarray, report: Report) -> Iterator[ImageBatch]:
        """Yield the pictures at the times of their frames, (frame_count,); report those that are left out."""
        ...

    def decode(self, frames: list[int]) -> Iterator[tuple[int, av.VideoFrame]] | None:
        """Decode these frames straight from the file; None where `read` is as short."""
        ...


class VideoPictures:
    """A camera in a video file."""

    def __init__(self, feature: Feature, clip: Clip) -> None:
        """Raises SourceError when the file is missing or cannot be read."""
        self.clip, self.scan = clip, scan_clip(clip)
        self._codes = feature.is_depth and self.scan.pixel_format in CODE_FORMATS
        self._depth = DepthCode.from_info(feature.info)
        self.stream = Stream(
            feature.key,
            "depth" if feature.is_depth else "camera",
            len(self.scan.frames),
            clip.rate_hz if len(self.scan.frames) > 1 else None,
            (self.scan.height, self.scan.width) + (() if self._codes else (3,)),
            "png" if self._codes else self.scan.encoding,
            f"video/{self.scan.codec}",
        )
        self.max_bytes = self.scan.max_bytes
        if self._codes:
            self.max_bytes = len(self.scan.frames) * (2 * self.scan.width * self.scan.height + 4096)

    def read(self, frame_ns: np.ndarray, report: Report) -> Iterator[ImageBatch]:
        batches = (
            in_batches(read_depth_clip(self.clip, self._depth), self.stream.name, "png", frame_ns)
            if self._codes
            else read_clip(self.clip, self.scan, self.stream.name, frame_ns)
        )
        count = 0
        for batch in batches:
            count += len(batch.data)
            yield batch
        if count < len(self.scan.frames):
            what = f"{len(self.scan.frames) - count} of {len(self.scan.frames)} pictures do not decode"
            report(Problem(self.clip.label, what, "Their frames stay empty; record the episode again.", "error"))

    def decode(self, frames: list[int]) -> Iterator[tuple[int, av.VideoFrame]] | None:
        return None if self._codes else self._decode(np.intersect1d(frames, self.scan.frames).tolist())

    def _decode(self, frames: list[int]) -> Iterator[tuple[int, av.VideoFrame]]:
        expected = iter(frames)
        for frame, picture in decode_clip(self.clip, frames):
            if frame != (due := next(expected)):
                raise self._undecodable(due)
            yield frame, picture
        if (due := next(expected, None)) is not None:
            raise self._undecodable(due)

    def _undecodable(self, frame: int) -> SourceError:
        return SourceError(
            f"{self.clip.label}, {self.stream.name}, frame {frame}: the picture cannot be decoded. "
            "Go on without this camera, or record the episode again."
        )


class ColumnPictures:
    """A camera whose pictures are files inside the Parquet file, `struct{bytes, path}`."""

    def __init__(self, feature: Feature, rows: EpisodeRows, info: DatasetInfo) -> None:
        """Raises SourceError when the file has no such column."""
        if feature.key not in rows.schema.names:
            raise SourceError(f"{rows.label}: has no column {feature.key!r}. Download the dataset again.")
        self._key, self._rows, self._info = feature.key, rows, info
        self._where = f"{rows.label}, {feature.key}"
        self.max_bytes = rows.max_bytes(feature.key)
        first = next((kind for _, _, kind in self._samples(lambda _: None) if kind), "png")
        self.stream = Stream(
            feature.key,
            "depth" if feature.is_depth else "camera",
            rows.count,
            info.fps if rows.count > 1 else None,
            feature.height_width + (() if feature.is_depth else (3,)),
            first,
            "image",
        )

    def read(self, frame_ns: np.ndarray, report: Report) -> Iterator[ImageBatch]:
        held: list[tuple[int, bytes]] = []
        kind = ""
        for frame, data, encoding in self._samples(report):
            if held and (encoding != kind or len(held) == BATCH_FRAMES):
                yield from in_batches(held, self._key, kind, frame_ns)
                held = []
            kind = encoding
            held.append((frame, data))
        yield from in_batches(held, self._key, kind, frame_ns)

    def decode(self, frames: list[int]) -> Iterator[tuple[int, av.VideoFrame]] | None:
        return None

    def _samples(self, report: Report) -> Iterator[tuple[int, bytes, str]]:
        """Whole JPEG or PNG files with their frame; what is neither is left out and reported at the end."""
        bad: list[int] = []
        for first, batch in self._rows.batches([self._key], BATCH_FRAMES):
            for frame, cell in enumerate(batch.column(0).to_pylist(), first):
                data = self._bytes_of(cell)
                kind = next((name for magic, name in _MAGIC if data and data.startswith(magic)), "")
                if kind == "tiff":
                    data, kind = tiff_to_png16(data or b""), "png"
                if data and kind:
                    yield frame, data, kind
                else:
                    bad.append(frame)
        if bad:
            what = f"{len(bad)} of {self._rows.count} frames have no JPEG or PNG picture, the first is frame {bad[0]}"
            report(Problem(self._where, what, "They stay empty; download or record the episode again.", "error"))

    def _bytes_of(self, cell: object) -> bytes | None:
        if isinstance(cell, dict):
            data, path = cell.get("bytes"), cell.get("path")
            return data if data or not isinstance(path, str) else self._file(path)
        return cell if isinstance(cell, bytes) else None

    def _file(self, path: str) -> bytes | None:
        """A picture beside the Parquet file; only from inside the dataset."""
        if Path(path).is_absolute() or ".." in Path(path).parts:
            return None
        try:
            return (self._info.root / path).read_bytes()
        except (OSError, ValueError):
            return None
