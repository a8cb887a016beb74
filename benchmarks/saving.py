"""An edit until it is acknowledged and durable, with 500 segments in the file; and what the disk alone takes."""

import json
import os
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench import Bench, interleaved
from recordings import recording
from report import Line, percentile
from server import Server

from jiti.annotate.folder import segments_path
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment, new_segment_id

NAME = "saving"
LIMIT_MS = 20.0
SEGMENTS = 500
EDITS = 300
AT_ONCE = 100
"""Segments of one request: fewer than the 1 MiB that the server takes."""
FRAMES = 25
"""Length of a segment, the paper's window."""


def measure(bench: Bench) -> Iterator[Line]:
    path = recording(bench, bench.count(60, 10))
    edits = bench.count(EDITS, 20)
    with bench.folder() as folder:
        with Server(folder / "home", "annotate", str(path), "--labels", str(folder / "web"), "--annotator", "ann") as s:
            over_http, parquet = _over_http(s, path.stem, folder / "web")
            applied = _applied(folder / "store")
            bare = _bare(folder, parquet.stat().st_size)
            with bench.progress("Saving") as say:
                say(0.0, f"{edits} edits")
                found = interleaved(edits, http=over_http, apply=applied, bare=bare)
        size = f"{parquet.stat().st_size / 1e3:.0f} kB with {SEGMENTS} segments"
    yield from _lines("peer: write, fsync, rename, fsync of the folder", found["bare"], note=f"the same file, {size}")
    yield from _lines("Partition.apply alone", found["apply"], note="two files and the folder are flushed")
    yield from _lines("POST edits until the answer is read", found["http"], limit=LIMIT_MS)


def _lines(what: str, times_s: list[float], *, limit: float | None = None, note: str = "") -> Iterator[Line]:
    times_ms = [1000 * t for t in times_s]
    for name, share in (("p50", 0.5), ("p95", 0.95), ("max", 1.0)):
        yield Line(
            NAME,
            f"{what}: {name}",
            percentile(times_ms, share),
            "ms",
            len(times_ms),
            limit=limit if name == "p95" else None,
            note=note if name == "p50" else "",
        )


def _over_http(server: Server, episode_id: str, labels_dir: Path) -> tuple[Callable[[], float], Path]:
    """What the page does for an edge that is moved by one frame."""
    where = f"/api/episodes/{episode_id}"
    episode = server.get(where)
    itcs, last = [itc["itc_id"] for itc in episode["task"]["itcs"]], episode["frame_count"] - 1
    version, rows = episode["version"], []
    for first in range(0, SEGMENTS, AT_ONCE):
        put = [_fields(n, itcs[n % len(itcs)], last) for n in range(first, first + AT_ONCE)]
        body = {"action": "mark", "put": put, "remove": [], "based_on": version}
        answer = json.loads(server.post(f"{where}/edits", body))
        version, rows = answer["version"], rows + answer["changed"]
    if len(rows) != SEGMENTS:
        raise RuntimeError(f"{len(rows)} segments were saved, not {SEGMENTS}")
    draw = random.Random(0)
    sent = ("segment_id", "itc_id", "start_frame", "end_frame", "reward", "rationale")

    def edit() -> float:
        nonlocal version
        row = draw.choice(rows)
        row["end_frame"] += -1 if row["end_frame"] > row["start_frame"] else 1
        body = {"action": "nudge", "put": [{name: row[name] for name in sent}], "remove": [], "based_on": version}
        start = time.perf_counter()
        answer = server.post(f"{where}/edits", body)
        taken_s = time.perf_counter() - start
        version = json.loads(answer)["version"]
        return taken_s

    return edit, segments_path(labels_dir, "ann", episode_id)


def _fields(number: int, itc_id: str, last: int) -> dict[str, Any]:
    start = number * 3 % (last - FRAMES)
    return {"itc_id": itc_id, "start_frame": start, "end_frame": start + FRAMES - 1, "reward": number % 2}


def _applied(labels_dir: Path) -> Callable[[], float]:
    """The store without the server."""
    partition = Partition(labels_dir, "ann", "episode", Recording(1800, 30.0, "0" * 32))
    rows = [
        Segment(
            segment_id=new_segment_id(),
            episode_id="episode",
            itc_id=f"task/constraint-{n % 4}",
            criterion="task_sequence_integrity",
            start_frame=n * 3,
            end_frame=n * 3 + FRAMES - 1,
            start_ns=n * 10**8,
            end_ns=n * 10**8 + 8 * 10**8,
            reward=n % 2,
        )
        for n in range(SEGMENTS)
    ]
    partition.apply("mark", rows, based_on=0)
    draw = random.Random(1)

    def edit() -> float:
        row = draw.choice(partition.segments)
        row = replace(row, end_frame=row.end_frame - 1 if row.end_frame > row.start_frame else row.end_frame + 1)
        start = time.perf_counter()
        partition.apply("nudge", [row], based_on=partition.version)
        return time.perf_counter() - start

    return edit


def _bare(folder: Path, size: int) -> Callable[[], float]:
    """As many bytes as the labels, replaced as durably and with nothing else."""
    path, data = folder / "bare.bin", os.urandom(size)

    def save() -> float:
        start = time.perf_counter()
        temporary = path.with_suffix(".tmp")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.write(descriptor, data)
        os.fsync(descriptor)
        os.close(descriptor)
        temporary.replace(path)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        os.fsync(descriptor)
        os.close(descriptor)
        return time.perf_counter() - start

    return save
