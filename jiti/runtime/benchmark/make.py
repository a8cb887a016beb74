"""Recordings, the simulator's labels, and the datasets of them."""

import hashlib
import shutil
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from jiti.annotate.autolabel import autolabel
from jiti.annotate.folder import annotator_dirs
from jiti.annotate.labels import read_labels
from jiti.annotate.names import MACHINES, file_stem
from jiti.annotate.proposals import accept, pending
from jiti.annotate.proposer import Proposer
from jiti.annotate.segment_file import Recording, to_segments
from jiti.annotate.segments import Segment
from jiti.annotate.store import LabelStore
from jiti.curate.export.command import Request, curate
from jiti.durable import make_folder
from jiti.episodes.reader import open_reader
from jiti.errors import LabelError
from jiti.progress import Progress
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.plan import BenchmarkPlan
from jiti.runtime.benchmark.stages import Stage
from jiti.runtime.sim.record import Plan, Recorded, record
from jiti.tasks.task import Task

SIMULATOR = "sim"
"""Whose proposals count, but those that people settled."""


def recordings_plan(plan: BenchmarkPlan, task: Task, assets: str | None) -> Plan:
    """Of the demonstrations of a task."""
    data = plan.data
    return Plan(
        task,
        data.quality,
        data.seed,
        data.start,
        assets,
        data.cameras,
        disturbance=data.disturbance,
    )


def make_recordings(
    plan: Plan, folder: Path, *, episodes: int, workers: int | None, progress: Progress
) -> dict[str, Any]:
    """Demonstrate a task. Raises UsageError, SaveFailed; what is whole is kept."""
    recorded = record(plan, folder, episodes=episodes, workers=workers, progress=progress)
    return counts(recorded)


def counts(recorded: Sequence[Recorded]) -> dict[str, Any]:
    """For the report."""
    return {
        "episodes": len(recorded),
        "success": sum(one.success for one in recorded),
        "elegant": sum(one.elegant for one in recorded),
        "steps": sum(one.steps for one in recorded),
    }


def make_labels(folder: Path, episodes: int, progress: Progress) -> dict[str, Any]:
    """Propose what the simulator decided for every recording of a folder. Raises LabelError where some are left out."""
    reader = open_reader(folder)
    labels_dir = Path(reader.labels_dir).absolute()
    labelled = autolabel(reader, Proposer(str(folder.absolute()), labels_dir, by=SIMULATOR), progress=progress)
    if labelled.episodes < episodes:
        raise LabelError(
            f"{folder} has {episodes} recordings, but proposals for {labelled.episodes}: "
            f"{'; '.join(labelled.skipped[:3])}"
        )
    return {"episodes": labelled.episodes, "satisfied": labelled.satisfied, "violated": labelled.violated}


def accept_all(folder: Path, episodes: Collection[str], annotator: str) -> int:
    """Accept every proposal for some episodes that no one has decided yet, as it is, in the name of an annotator; say
    how many.

    What people rejected or changed stays. Raises LabelError, SaveFailed.
    """
    reader = open_reader(folder)
    store = LabelStore(Path(reader.labels_dir).absolute())
    found = read_labels(store.labels_dir).whole().segments
    decided = [name for name in found["parent_id"].to_pylist() if name]
    proposals = to_segments(found.filter(pa.array([name in MACHINES for name in found["annotator"].to_pylist()])))
    accepted: dict[str, list[Segment]] = {}
    for proposal in pending(proposals, decided):
        if proposal.reward is not None and proposal.episode_id in episodes:
            accepted.setdefault(proposal.episode_id, []).append(accept(proposal))
    for episode_id, segments in accepted.items():
        episode = reader.open(episode_id)
        recording = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
        partition = store.partition(annotator, episode_id, recording)
        partition.apply("accept", put=segments, based_on=partition.version)
    return sum(map(len, accepted.values()))


def recording_names(plan: BenchmarkPlan, stem: str) -> list[str]:
    """Of a task's recordings, by the name of its stage: of their files, without the suffix, and of the episodes."""
    return [f"{stem}_{seed:04d}" for seed in range(plan.data.seed, plan.data.seed + plan.data.episodes)]


def make_dataset(work: Work, stage: Stage, plan: BenchmarkPlan, progress: Progress) -> dict[str, Any]:
    """Curate the recordings of the stages that a dataset needs. Raises JitiError; then nothing is there."""
    out = work.folder(stage)
    if out.exists():  # whole, but killed before that was written down: `jiti curate` gives the name last
        shutil.rmtree(out)
    make_folder(out.parent)
    sources: list[str] = []
    labels: tuple[Path, ...] = ()
    for needed in stage.needs:
        recordings = work.folder(needed.needs[0])
        if work.flat:
            # By file: whatever else lies there is not learned from.
            sources += [str(recordings / f"{name}.mcap") for name in recording_names(plan, needed.name)]
            labels = (recordings / "labels",)
        else:
            sources.append(str(recordings))
    done = curate(
        Request(
            sources=tuple(sources),
            labels=labels,
            out=out,
            accept=(SIMULATOR,),
            split=stage.inputs["split"],
            seed=stage.inputs["seed"],
            gamma=stage.inputs["gamma"],
            report=True,
        ),
        progress,
    )
    return {
        "episodes": done.episodes,
        "frames": done.frames,
        "elegant": done.elegant,
        "judged": done.judged,
        "splits": done.splits,
    }


def reviewed(labels_dir: Path, episodes: Iterable[str]) -> str:
    """Hex digest of what people decided on some episodes in a folder of labels; empty where no one has."""
    files = [f"{file_stem(episode_id)}.parquet" for episode_id in episodes]
    people = sorted((name, folder) for name, folder in annotator_dirs(labels_dir) if name not in MACHINES)
    decided = [(name, path) for name, folder in people for file in files if (path := folder / file).is_file()]
    digest = hashlib.sha256()
    for name, path in decided:
        digest.update(f"{name}\0{path.name}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16] if decided else ""
