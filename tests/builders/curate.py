"""Labelled recordings for tests of `jiti curate`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jiti.annotate.proposals import write_proposals
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment
from jiti.annotate.store import LabelStore
from jiti.curate.export.command import Request, curate
from jiti.curate.export.curated import Curated
from jiti.episodes.reader import open_reader
from tests.builders.labels import segment
from tests.builders.mcap import Camera, write_mcap

ITC = "generic/pose_alignment"
Marks = Sequence[tuple[int, int, int]]
"""First frame, last frame, verdict."""


def write_picks(
    folder: Path, marks: Sequence[Marks | None], *, cameras: Mapping[str, Camera] | None = None, **options: Any
) -> Path:
    """A recording `pick_<i>.mcap` for each entry, labelled by `ann` with these segments; None for no label."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, _ in enumerate(marks):
        given = {"duration_s": 1.0 + 0.2 * (number % 3), "instruction": "pick the cube", **options}
        write_mcap(folder / f"pick_{number}.mcap", cameras=cameras or {}, **given)
    for number, of_episode in enumerate(marks):
        if of_episode is not None:
            mark(folder, f"pick_{number}", of_episode)
    return folder


def mark(source: Path, episode_id: str, marks: Marks, *, annotator: str = "ann", itc: str = ITC) -> list[Segment]:
    """Label an episode of a source as a person does."""
    rows = [
        segment(start, end, reward, episode_id=episode_id, itc_id=itc, criterion="pose_alignment")
        for start, end, reward in marks
    ]
    put(source, episode_id, rows, annotator=annotator)
    return rows


def put(source: Path, episode_id: str, rows: Sequence[Segment], *, annotator: str) -> None:
    """Save rows in a person's partition."""
    reader = open_reader(source)
    partition = LabelStore(Path(reader.labels_dir)).partition(annotator, episode_id, recording_of(source, episode_id))
    partition.apply("mark", rows, based_on=partition.version)


def propose(source: Path, episode_id: str, marks: Marks, *, machine: str = "sim", itc: str = ITC) -> list[Segment]:
    """Propose segments as a machine does."""
    rows = [
        segment(start, end, reward, episode_id=episode_id, itc_id=itc, status="proposed", source=machine)
        for start, end, reward in marks
    ]
    labels_dir = Path(open_reader(source).labels_dir)
    write_proposals(labels_dir, machine, episode_id, rows, recording_of(source, episode_id))
    return rows


def recording_of(source: Path, episode_id: str) -> Recording:
    """What labels note of a recording."""
    episode = open_reader(source).open(episode_id)
    return Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)


def curated(*sources: Path, out: Path, **options: Any) -> Curated:
    """Curate with these options."""
    return curate(Request(sources=tuple(str(source) for source in sources), out=out, **options))
