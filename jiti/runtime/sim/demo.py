"""`jiti demo`: a scripted pick recorded, read back, and proposals made where its gripper moves."""

from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.labels import read_segments
from jiti.annotate.proposals import write_proposals
from jiti.annotate.segment_file import Recording
from jiti.annotate.signals import ANNOTATOR, propose_segments
from jiti.durable import write_atomic
from jiti.episodes.episode import Episode
from jiti.episodes.reader import open_reader
from jiti.errors import LabelError, SourceError
from jiti.runtime.sim.lift import TASK_FILE
from jiti.runtime.sim.record import Progress, record_demo, recorded_metadata
from jiti.tasks.catalogue import load_catalogue

DEMO_FOLDER = Path("jiti-demo")
"""In the current folder."""


@dataclass(frozen=True, slots=True)
class DemoEpisode:
    """One recording, as it reads back."""

    path: Path
    episode_id: str
    frame_count: int
    cameras: tuple[str, ...]
    lifted: bool
    """Whether the cube stood over the table at the end."""
    proposals: int


@dataclass(frozen=True, slots=True)
class DemoSummary:
    """What `demo` made, all of it read back from the disk. Its text is for a person."""

    folder: Path
    labels_dir: Path
    task_file: Path
    """The task that was recorded, in `folder`: what `--tasks` needs to know its constraints."""
    episodes: tuple[DemoEpisode, ...]

    def __str__(self) -> str:
        lines = [
            f"{e.path}: {e.frame_count} frames, {len(e.cameras)} cameras, {e.proposals} proposals, "
            f"cube {'lifted' if e.lifted else 'not lifted'}"
            for e in self.episodes
        ]
        return "\n".join([*lines, f"Proposals are in {self.labels_dir}, the task in {self.task_file}."])


def demo(
    folder: Path = DEMO_FOLDER, *, episodes: int = 1, seed: int = 0, progress: Progress | None = None
) -> DemoSummary:
    """Record scripted picks into `folder`, propose segments for them, and check that all of it reads back.

    What is there already is kept: recordings with this seed, the task file, what people decided. Raises
    UsageError when the simulation cannot run here, SaveFailed when the disk refuses, SourceError or LabelError when
    something does not read back as it was written.
    """
    paths = record_demo(folder, episodes=episodes, seed=seed, progress=progress)
    task_file = folder / "tasks.toml"
    if not task_file.exists():
        write_atomic(task_file, TASK_FILE.read_bytes())
    reader = open_reader(folder)
    labels_dir = Path(reader.labels_dir)
    by_path = {path.stem: path for path in paths}
    found = []
    for ref in reader.episodes():
        path = by_path.pop(ref.title.removesuffix(".mcap"), None)
        if path is not None:
            found.append(_propose(path, reader.open(ref.episode_id), labels_dir))
    if by_path:
        missing = ", ".join(str(path) for path in by_path.values())
        raise SourceError(f"{missing} was recorded but is not listed in {folder}. Delete the folder and run it again.")
    return DemoSummary(folder, labels_dir, task_file, tuple(found))


def _propose(path: Path, episode: Episode, labels_dir: Path) -> DemoEpisode:
    metadata = recorded_metadata(path)
    _check_counts(path, episode, int(metadata.get("steps", 0)))
    clock = episode.clock
    proposals = propose_segments(episode, load_catalogue(TASK_FILE).for_instruction(episode.task))
    recording = Recording(clock.frame_count, clock.rate_hz, episode.fingerprint)
    count = write_proposals(labels_dir, ANNOTATOR, episode.episode_id, proposals, recording)
    rows = read_segments(labels_dir, annotators=[ANNOTATOR], episodes=[episode.episode_id])
    if rows.num_rows != count:
        raise LabelError(f"{count} proposals for {path} were written to {labels_dir}, but {rows.num_rows} read back")
    cameras = tuple(name for name, stream in episode.streams.items() if stream.kind == "camera")
    lifted = metadata.get("lifted") == "true"
    return DemoEpisode(path, episode.episode_id, clock.frame_count, cameras, lifted, count)


def _check_counts(path: Path, episode: Episode, steps: int) -> None:
    """Every step is a frame, and every camera has a picture of each. Raises SourceError."""
    if episode.problems:
        raise SourceError(f"{path} does not read back well: {episode.problems[0]}")
    counts = {name: s.count for name, s in episode.streams.items() if s.kind == "camera"}
    counts = (
        {**counts, "frames": episode.clock.frame_count} if counts else {"/gripper": episode.streams["/gripper"].count}
    )
    for name, count in counts.items():
        if count != steps:
            raise SourceError(
                f"{path}: {steps} steps were recorded, but {name} has {count}. Delete it and run it again."
            )
