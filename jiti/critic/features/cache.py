"""Features of a dataset, computed once: one memory-mapped array, filled shard by shard, by several processes if asked.

A folder for each pair of dataset and extractor:

    features.bin   (frames, tokens, size), little-endian float32 or bfloat16, in the dataset's index order
    valid.bin      (frames,) bytes: 1 where a frame's features are computed and finite
    done/00000012  one empty file for each shard that is on the disk
    about.json     sizes and both fingerprints; written first, and what a reader compares

A shard's rows are synced before its name appears in `done`, so that a run that was killed goes on with the shards that
lack it. Two runs at once on one cache compute some shards twice, and write the same bytes.
"""

import json
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import platformdirs

from jiti.critic.dataset import ElegantData
from jiti.critic.features.base import FeatureExtractor, Shapes, open_extractor
from jiti.critic.features.rows import observations
from jiti.durable import make_folder, save_failed, sync, sync_folder, write_atomic, write_whole
from jiti.errors import SourceError
from jiti.progress import Progress

if TYPE_CHECKING:
    import torch

VERSION = 1
SHARD_FRAMES = 2048
"""Frames that are computed between two marks of progress. Our choice: minutes of a large policy on a CPU."""
BATCH_FRAMES = 32
"""Frames that an extractor gets at once. Our choice: fits a 3B policy on a 24 GB GPU."""

Kind = Literal["float32", "bfloat16"]
_BYTES = {"float32": 4, "bfloat16": 2}


@dataclass(frozen=True)
class FeatureCache:
    """Features of all frames, read from the disk as they are asked for."""

    folder: Path
    rows: np.ndarray
    """(frames, tokens, size), mapped; float32, or bfloat16 as uint16."""
    kind: Kind
    extractor: str
    """Name and fingerprint of what made them."""
    fingerprint: str

    @property
    def tokens(self) -> int:
        return self.rows.shape[1]

    @property
    def size(self) -> int:
        return self.rows.shape[2]

    def read(self, frames: np.ndarray) -> "torch.Tensor":
        """Features (B, tokens, size) float32 of frames (B,)."""
        import torch

        rows = torch.from_numpy(self.rows[frames])
        return rows if self.kind == "float32" else rows.view(torch.bfloat16).float()


def feature_cache(
    data: ElegantData,
    name: str,
    *,
    folder: Path | None = None,
    device: str = "cpu",
    workers: int = 1,
    kind: Kind | None = None,
    progress: Progress = lambda _share, _what: None,
) -> FeatureCache:
    """The cache of a dataset's features, computed where it is not yet.

    `folder` holds caches (default: the user's cache folder). `kind` defaults to what the extractor gives. Raises
    UsageError for an extractor that cannot be opened, SourceError for frames whose features are not finite, SaveFailed.
    """
    extractor = open_extractor(name, data.shapes, device=device)
    kind = kind or ("float32" if name == "state" else "bfloat16")
    about = _about(data, extractor, kind)
    key = f"{name.partition(':')[0]}-{extractor.fingerprint[:12]}-{data.fingerprint[:12]}-{kind}"
    at = (folder or platformdirs.user_cache_path("jiti") / "features") / key
    _prepare(at, about)
    shards = -(-data.frames // SHARD_FRAMES)
    left = [shard for shard in range(shards) if not _mark(at, shard).exists()]
    if left:
        job = _Job(at, data.root, data.fingerprint, data.frames, dict(data.shapes), name, device, kind, SHARD_FRAMES)
        for done, shard in enumerate(_filled(job, extractor, left, workers), 1):
            progress((shards - len(left) + done) / shards, f"features of frame {shard * SHARD_FRAMES} and on")
    return open_cache(at)


def open_cache(folder: Path) -> FeatureCache:
    """A cache that is complete. Raises SourceError for one that is not, or whose files are of other sizes."""
    try:
        about = json.loads((folder / "about.json").read_bytes())
        frames, tokens, size, kind = (about[name] for name in ("frames", "tokens", "size", "kind"))
        rows = np.memmap(folder / "features.bin", _dtype(kind), mode="r", shape=(frames, tokens, size))
        valid = np.fromfile(folder / "valid.bin", np.uint8) == 1
    except (OSError, ValueError, KeyError) as error:
        raise SourceError(f"{folder} is no cache of features: {error}. Delete the folder; it is made again.") from error
    if len(valid) != frames or any(not _mark(folder, s).exists() for s in range(-(-frames // SHARD_FRAMES))):
        raise SourceError(f"{folder} is not complete. Run `jiti train-critic` again: it goes on there.")
    if not valid.all():
        raise SourceError(
            f"{folder}: features of {int((~valid).sum())} frames are not numbers, the first at index "
            f"{int(np.argmin(valid))}. Look at that frame, mend or leave out its recording, and delete the folder."
        )
    return FeatureCache(folder, rows, kind, about["extractor"], about["extractor_fingerprint"])


@dataclass(frozen=True)
class _Job:
    """What a process needs to fill shards."""

    at: Path
    root: Path
    dataset: str
    """Its fingerprint."""
    frames: int
    shapes: Shapes
    name: str
    device: str
    kind: Kind
    shard_frames: int


def _about(data: ElegantData, extractor: FeatureExtractor, kind: Kind) -> dict[str, Any]:
    return {
        "version": VERSION,
        "extractor": extractor.name,
        "extractor_fingerprint": extractor.fingerprint,
        "dataset": str(data.root),
        "dataset_fingerprint": data.fingerprint,
        "frames": data.frames,
        "tokens": extractor.tokens,
        "size": extractor.size,
        "kind": kind,
        "shard_frames": SHARD_FRAMES,
    }


def _prepare(at: Path, about: dict[str, Any]) -> None:
    """The folder with empty arrays of the right sizes, unless it is there."""
    make_folder(at.parent)
    make_folder(at)
    make_folder(at / "done")
    known = at / "about.json"
    try:
        old = json.loads(known.read_bytes()) if known.exists() else {}
    except ValueError:
        old = {}
    if {k: v for k, v in old.items() if k != "dataset"} == {k: v for k, v in about.items() if k != "dataset"}:
        return
    for mark in (at / "done").iterdir():
        mark.unlink()
    row_bytes = about["tokens"] * about["size"] * _BYTES[about["kind"]]
    for name, size in (("features.bin", about["frames"] * row_bytes), ("valid.bin", about["frames"])):
        try:
            with (at / name).open("wb") as file:
                if hasattr(os, "posix_fallocate"):  # so that a full disk is told now, and not in the middle
                    os.posix_fallocate(file.fileno(), 0, max(1, size))
                file.truncate(size)
                sync(file.fileno())
        except OSError as error:
            (at / name).unlink(missing_ok=True)
            raise save_failed(at / name, error) from error
    write_atomic(known, json.dumps(about, indent=2).encode())


def _filled(job: _Job, extractor: FeatureExtractor, shards: list[int], workers: int) -> Any:
    if workers <= 1 or len(shards) == 1:
        for shard in shards:
            _fill(job, extractor, shard)
            yield shard
        return
    with ProcessPoolExecutor(workers, get_context("spawn"), _begin, (job, workers)) as pool:
        for future in as_completed([pool.submit(_fill_here, shard) for shard in shards]):
            yield future.result()


_here: list[tuple[_Job, FeatureExtractor]] = []
"""What this worker process works on."""


def _begin(job: _Job, workers: int) -> None:
    import torch

    torch.set_num_threads(max(1, (os.cpu_count() or 1) // workers))
    _here.append((job, open_extractor(job.name, job.shapes, device=job.device)))


def _fill_here(shard: int) -> int:
    job, extractor = _here[-1]
    _fill(job, extractor, shard)
    return shard


def _fill(job: _Job, extractor: FeatureExtractor, shard: int) -> None:
    """Compute and write the rows of one shard, then its mark."""
    import torch

    first = shard * job.shard_frames
    stop = min(first + job.shard_frames, job.frames)
    parts = []
    with torch.inference_mode():
        for batch in observations(job.root, job.dataset, extractor.needs, first, stop, BATCH_FRAMES):
            parts.append(extractor.features(batch).float().cpu())
    rows = torch.cat(parts)
    if rows.shape != (stop - first, extractor.tokens, extractor.size):
        raise SourceError(
            f"{extractor.name} gave features of shape {tuple(rows.shape)} for frames {first} to {stop - 1}; it said "
            f"{(stop - first, extractor.tokens, extractor.size)}."
        )
    valid = torch.isfinite(rows).flatten(1).all(1).numpy().astype(np.uint8)
    packed = rows.numpy() if job.kind == "float32" else rows.to(torch.bfloat16).view(torch.uint16).numpy()
    row_bytes = packed.nbytes // len(packed)
    _put(job.at / "features.bin", first * row_bytes, np.ascontiguousarray(packed))
    _put(job.at / "valid.bin", first, valid)
    try:
        _mark(job.at, shard).touch()
        sync_folder(job.at / "done")
    except OSError as error:
        raise save_failed(_mark(job.at, shard), error) from error


def _put(path: Path, offset: int, rows: np.ndarray) -> None:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.lseek(descriptor, offset, os.SEEK_SET)
            write_whole(descriptor, rows.data.cast("B"))
            sync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise save_failed(path, error) from error


def _mark(at: Path, shard: int) -> Path:
    return at / "done" / f"{shard:08d}"


def _dtype(kind: str) -> Any:
    return np.dtype("<f4") if kind == "float32" else np.dtype("<u2")
