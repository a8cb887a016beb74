"""Where labels lie, and how to tell cheaply that some changed.

<labels>/segments/annotator=<name>/<episode>.parquet     what holds now
<labels>/history/annotator=<name>/<episode>.jsonl        every edit that led there
<labels>/rewards.parquet                                 derived from the segments
"""

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from jiti.annotate.names import check_name, file_stem
from jiti.durable import make_folder, write_atomic

_PREFIX = "annotator="


def segments_dir(labels_dir: Path) -> Path:
    """A hive-partitioned dataset of Parquet files."""
    return labels_dir / "segments"


def segments_path(labels_dir: Path, annotator: str, episode_id: str) -> Path:
    """The Parquet file of one partition. Raises LabelError for names that cannot be file names."""
    return segments_dir(labels_dir) / f"{_PREFIX}{check_name(annotator)}" / f"{file_stem(episode_id)}.parquet"


def history_path(labels_dir: Path, annotator: str, episode_id: str) -> Path:
    """The history of one partition. Raises LabelError for names that cannot be file names."""
    return labels_dir / "history" / f"{_PREFIX}{check_name(annotator)}" / f"{file_stem(episode_id)}.jsonl"


def aside(path: Path) -> Path:
    """A name that is not taken for keeping a damaged file: beside it, hidden from dataset readers."""
    stamp = f"{time.strftime('%Y%m%dT%H%M%S', time.gmtime())}-{time.time_ns() % 10**9:09}"
    return path.with_name(f".{path.name}.damaged-{stamp}")


def annotator_dirs(labels_dir: Path) -> Iterator[tuple[str, Path]]:
    """Annotators and the folders of their files, by name; a stray file under such a name is left alone."""
    root = segments_dir(labels_dir)
    if root.is_dir():
        for path in sorted(root.iterdir()):
            if path.name.startswith(_PREFIX) and path.is_dir():
                yield path.name.removeprefix(_PREFIX), path


def write_segments_file(path: Path, data: memoryview, *, locked: bool) -> None:
    """Replace one Parquet file, durably, so that `labels_version` tells. Raises SaveFailed."""
    make_folder(path.parent)
    write_atomic(path, data, locked=locked)
    # A rename moves the folder's time only by the kernel's tick of up to 10 ms; two in one tick would look like one.
    with suppress(OSError):  # not the owner of a shared folder: the tick must do
        os.utime(path.parent, ns=(now := time.time_ns(), now))


def labels_version(labels_dir: Path) -> str:
    """A short text that changes when any partition does. Costs one `stat` an annotator, however many episodes."""
    digest = hashlib.sha256()
    for name, folder in annotator_dirs(labels_dir):
        status = folder.stat()
        digest.update(f"{name}\0{status.st_mtime_ns}\0{status.st_ino}\n".encode())
    return digest.hexdigest()[:16]
