"""`jiti demo`: a benchmark task demonstrated well and badly, read back, and judged by the simulator for review."""

from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.autolabel import Autolabelled, autolabel
from jiti.annotate.proposer import Proposer
from jiti.episodes.episode import Episode
from jiti.episodes.reader import open_reader
from jiti.errors import LabelError, SourceError
from jiti.runtime.sim.record import Plan, Progress, Recorded, record
from jiti.tasks.catalogue import load_catalogue

DEMO_FOLDER = Path("jiti-demo")
"""In the current folder."""
DEMO_TASK = "elegant/T2"
"""The bowl on the plate: its ITC is the one that a person sees best."""
DEMO_EPISODES = 2
"""Our choice: with quality 0.5 and the default seed one is elegant and one is not."""


@dataclass(frozen=True, slots=True)
class DemoSummary:
    """What `demo` made, all of it read back from the disk. Its text is for a person."""

    folder: Path
    episodes: tuple[Recorded, ...]
    labelled: Autolabelled

    def __str__(self) -> str:
        lines = [
            f"{e.path}: {e.steps} frames, {len(e.cameras)} cameras, "
            f"{'elegant' if e.elegant else 'successful but not elegant' if e.success else 'not successful'}"
            for e in self.episodes
        ]
        return "\n".join([*lines, str(self.labelled)])


def demo(
    folder: Path = DEMO_FOLDER,
    *,
    task: str = DEMO_TASK,
    episodes: int = DEMO_EPISODES,
    seed: int = 0,
    progress: Progress | None = None,
) -> DemoSummary:
    """Record demonstrations of a benchmark task into `folder`, propose what the simulator saw, and check it.

    What is there already is kept: recordings of this task and seed, what people decided. Raises UsageError when the
    simulation cannot run here, SaveFailed when the disk refuses, SourceError or LabelError when something does not read
    back as it was written.
    """
    catalogue = load_catalogue()
    plan = Plan(catalogue.simulated(task), seed=seed)
    recorded = record(plan, folder, episodes=episodes, progress=progress)
    reader = open_reader(folder)
    _check(recorded, {ref.title: reader.open(ref.episode_id) for ref in reader.episodes()})
    labelled = autolabel(reader, Proposer(str(folder.absolute()), Path(reader.labels_dir).absolute(), by="sim"))
    if labelled.proposals < len(recorded):
        raise LabelError(f"{len(recorded)} episodes were recorded, but {labelled.labels_dir} holds fewer proposals")
    return DemoSummary(folder, tuple(recorded), labelled)


def _check(recorded: tuple[Recorded, ...] | list[Recorded], episodes: dict[str, Episode]) -> None:
    """Every step is a frame, and every camera has a picture of each. Raises SourceError."""
    for one in recorded:
        episode = episodes.get(one.path.name)
        if episode is None:
            raise SourceError(f"{one.path} was recorded but is not listed. Delete the folder and run it again.")
        if episode.problems:
            raise SourceError(f"{one.path} does not read back well: {episode.problems[0]}")
        counts = {name: s.count for name, s in episode.streams.items() if s.kind == "camera" or name == "/gripper"}
        for name, count in counts.items():
            if count != one.steps:
                raise SourceError(
                    f"{one.path}: {one.steps} steps were recorded, but {name} has {count}. Delete it and run it again."
                )
