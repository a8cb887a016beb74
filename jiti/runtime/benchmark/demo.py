"""`jiti demo`: the whole chain on one task, read back from the disk, in a folder in which every other command runs."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jiti.annotate.autolabel import autolabel
from jiti.annotate.engine import cores
from jiti.annotate.names import default_annotator
from jiti.annotate.proposer import Proposer
from jiti.episodes.episode import Episode
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError, UsageError
from jiti.progress import Progress
from jiti.runtime.benchmark.chain import Chain
from jiti.runtime.benchmark.command import Done, check_installed, report, run_chain
from jiti.runtime.benchmark.kept import Work
from jiti.runtime.benchmark.make import recordings_plan
from jiti.runtime.benchmark.plan import BenchmarkPlan, smaller
from jiti.runtime.benchmark.plan_file import read_plan
from jiti.runtime.sim.gl import Graphics, find_graphics
from jiti.runtime.sim.record import Plan, Recorded, differing, record, recorded_metadata
from jiti.runtime.sim.record_episode import OUTCOME
from jiti.runtime.sim.scene import CAMERAS
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.task import Task

PLAN = "demo"
SHOWN = "episode.mcap"
"""The first demonstration once more, with pictures: what `jiti annotate episode.mcap` opens. The others have none, for
rendering takes ten times as long as the rest of a step."""
SHOWN_SHARE = 0.05
"""Of the progress, for it."""


@dataclass(frozen=True)
class Request:
    """The command's arguments."""

    folder: Path
    task: str = "elegant/T2"
    episodes: int = 40
    seed: int = 0
    rollouts: int = 20
    workers: int | None = None
    quick: bool = False


@dataclass(frozen=True)
class Demonstrated:
    """What `demo` made. Its text is for a person."""

    folder: Path
    demonstrations: Sequence[Recorded]
    done: Done
    places: dict[str, Path] = field(default_factory=dict)
    """Of what was made, under the folder."""
    pictures: bool = True
    """Whether `episode.mcap` has pictures."""

    def __str__(self) -> str:
        elegant = sum(one.elegant for one in self.demonstrations)
        success = sum(one.success for one in self.demonstrations)
        blind = "" if self.pictures else "; without pictures: no GL library was found"
        opens = (
            (f"jiti annotate {SHOWN}", f"the first demonstration once more, to try it on (ESA){blind}"),
            ("jiti annotate", "all demonstrations; from what you change there the same `jiti demo` learns anew"),
            ("jiti validate-rewards", "rewards and returns of all of them (RVV)"),
            ("jiti autolabel --vlm", "a vision-language model proposes; needs a server, --vlm-url or $JITI_VLM_URL"),
            ("jiti rollout", "more rollouts with the policy and the critic that are here"),
            (f"jiti train-critic --evaluate {self._under('critic')}", "how well the critic ranks"),
            (f"jiti inspect {self._under('rollouts')}", "recordings of the rollouts"),
            (f"jiti curate --report {self._under('dataset')}", "the dataset, as a page"),
            (str(self.done.page.relative_to(self.folder)), "this run's figures"),
        )
        width = max(len(what) for what, _ in opens)
        lines = [
            f"{len(self.demonstrations)} demonstrations, {success} successful, {elegant} elegant.",
            str(self.done),
            f"To open each stage: cd {self.folder}, then",
            *(f"  {what:<{width}}  {why}" for what, why in opens),
        ]
        return "\n".join(lines)

    def to_json(self) -> str:
        """For `--json`."""
        content: dict[str, Any] = json.loads(self.done.to_json())
        told = {
            "folder": str(self.folder),
            "demonstrations": {
                "episodes": len(self.demonstrations),
                "success": sum(one.success for one in self.demonstrations),
                "elegant": sum(one.elegant for one in self.demonstrations),
            },
            "places": {name: str(path) for name, path in self.places.items()},
        }
        return json.dumps(told | content, indent=2)

    def _under(self, name: str) -> Path:
        return self.places[name].relative_to(self.folder)


def demo(
    request: Request,
    progress: Progress = lambda _share, _what: None,
    say: Callable[[str], None] = lambda _what: None,
) -> Demonstrated:
    """Do what is missing of the chain in a folder. Raises JitiError; what is finished is kept.

    Raises UsageError when something is not installed, SaveFailed when the disk refuses, SourceError when a recording
    does not read back as it was written.
    """
    check_installed()
    catalogue = load_catalogue()
    task = catalogue.simulated(request.task)
    plan = _plan(request, task)
    workers = request.workers or cores()
    work = Work(request.folder, flat=True)
    # In the user's name, so that what they change in ESA are their own rows; a changed label is then learned from.
    chain = Chain(
        work,
        plan,
        catalogue,
        plan.columns,
        plan.tasks,
        None,
        workers,
        record=True,
        annotator=default_annotator(),
        say=say,
    )
    run_chain(chain, (), lambda share, what: progress((1 - SHOWN_SHARE) * share, what))
    recorded = _recorded(plan, task, request.folder)
    progress(1 - SHOWN_SHARE, f"recording {SHOWN} with pictures")
    pictures = _show_one(plan, task, request.folder)
    progress(1.0, "writing the report")
    done = report(chain, request.folder)
    return Demonstrated(request.folder, recorded, done, _places(chain), pictures)


def _plan(request: Request, task: Task) -> BenchmarkPlan:
    plan = read_plan(PLAN)
    plan = replace(
        plan,
        title=f"jiti demo: {task.instruction}",
        data=replace(plan.data, tasks=(task.task_id,), episodes=request.episodes, seed=request.seed),
        rollouts=replace(plan.rollouts, episodes=request.rollouts),
    )
    if task.task_id != "elegant/T2":
        plan = replace(plan, note=f"{plan.note} Steps and episodes were chosen on elegant/T2.")
    return smaller(plan) if request.quick else plan


def _recorded(plan: BenchmarkPlan, task: Task, folder: Path) -> list[Recorded]:
    """The demonstrations, every one read back."""
    recorded = record(
        recordings_plan(plan, task, plan.data.assets),
        folder,
        episodes=plan.data.episodes,
    )
    reader = open_reader(folder)
    _check(recorded, {ref.title: reader.open(ref.episode_id) for ref in reader.episodes()})
    return recorded


def _show_one(plan: BenchmarkPlan, task: Task, folder: Path) -> bool:
    """Write `episode.mcap` and the simulator's proposals for it, unless they are there; say whether it has pictures.

    Raises UsageError where that file is no demonstration of the simulator.
    """
    shown = folder / SHOWN
    graphics = find_graphics()
    one = replace(recordings_plan(plan, task, plan.data.assets), cameras=tuple(CAMERAS))
    if not _is_first(shown, one, graphics):
        apart = folder / ".episode"
        (recorded,) = record(one, apart, episodes=1, workers=1, graphics=graphics)
        recorded.path.replace(shown)
        shutil.rmtree(apart)
    reader = open_reader(shown)
    autolabel(reader, Proposer(str(shown.absolute()), Path(reader.labels_dir).absolute(), by="sim"))
    episode = reader.open(reader.episodes()[0].episode_id)
    return any(stream.kind == "camera" for stream in episode.streams.values())


def _is_first(path: Path, plan: Plan, graphics: Graphics) -> bool:
    """Whether a recording is of a plan's first episode, with pictures or without; another task or seed may have been
    asked for before."""
    if not path.exists():
        return False
    found = recorded_metadata(path)
    if OUTCOME not in found:
        raise UsageError(f"{path} is another recording, and recordings are not replaced. Move that file away.")
    return not set(differing(found, plan.about(0, graphics))) - {"cameras", "picture_size"}


def _check(recorded: Sequence[Recorded], episodes: dict[str, Episode]) -> None:
    """Every step is a frame. Raises SourceError."""
    for one in recorded:
        episode = episodes.get(one.path.name)
        if episode is None:
            raise SourceError(f"{one.path} was recorded but is not listed. Delete it and run it again.")
        if episode.problems:
            raise SourceError(f"{one.path} does not read back well: {episode.problems[0]}")
        count = episode.streams["/gripper"].count
        if count != one.steps:
            raise SourceError(
                f"{one.path}: {one.steps} steps were recorded, but /gripper has {count}. Delete it and run it again."
            )


def _places(chain: Chain) -> dict[str, Path]:
    """Of the stages that the JITI column needs."""
    (column,) = [column for column in chain.plan.columns if column.method == "jiti"]
    (cell,) = chain.cells([column])
    rollouts = chain.work.folder(cell.stage)
    policy, critic = (cell.stage.needed(kind) for kind in ("policies", "critics"))
    if not rollouts.is_dir():
        raise UsageError(f"{rollouts} has no rollouts. Run it again.")
    return {
        "dataset": chain.work.folder(policy.needs[0]),
        "policy": chain.work.folder(policy),
        "critic": chain.work.folder(critic),
        "rollouts": rollouts,
    }
