"""`jiti record`: demonstrations of one task as a folder of recordings, on all cores, going on where it was stopped."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader

from jiti.annotate.engine import cores
from jiti.durable import make_folder
from jiti.episodes.mcap_contents import METADATA_NAME
from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.runtime.sim.demonstrators import expert_for
from jiti.runtime.sim.engine import find_robosuite
from jiti.runtime.sim.gl import Graphics, find_graphics
from jiti.runtime.sim.libero import bddl_file, pack_folder, pack_name
from jiti.runtime.sim.record_episode import OUTCOME, record_episode
from jiti.runtime.sim.scene import CAMERAS, CONTROL_HZ, Scene, Start
from jiti.runtime.workers import alone, check_stop, in_processes, remove_leftovers
from jiti.tasks.task import Task

_WITHOUT = {"disturbance": "0"}
"""What recordings are that do not say it, for jiti did not know of it then."""
TYPICAL_STEPS = 200
"""Steps of an episode, for progress alone."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What to record. Episode k of a plan is the same whatever else is recorded with it."""

    task: Task
    quality: float = 0.5
    """Share of the episodes that are meant to be elegant, spread evenly over seeds; 0 to 1."""
    seed: int = 0
    """Seed of the first episode; episode k has seed + k."""
    start: Start = "jitter"
    assets: str | None = None
    """Asset pack: a folder, "primitive" (the default) or "libero"."""
    cameras: tuple[str, ...] = tuple(CAMERAS)
    picture_size: int = 256
    disturbance: float = 0.0
    """Of the strongest push on the hand, which the demonstrator makes good, in the unit of an action; 0 to 1."""

    def __post_init__(self) -> None:
        if not 0 <= self.quality <= 1:
            raise UsageError(f"--quality {self.quality:g} is not in 0 to 1")
        if not 0 <= self.disturbance <= 1:
            raise UsageError(f"--disturbance {self.disturbance:g} is not in 0 to 1")
        if self.seed < 0:
            raise UsageError(f"--seed {self.seed} is negative; give 0 or more")
        for camera in self.cameras:
            if camera not in CAMERAS:
                raise UsageError(f"there is no camera {camera!r}; there are: {', '.join(CAMERAS)}, or none")
        if len(set(self.cameras)) < len(self.cameras):
            raise UsageError(f"a camera is named twice: {', '.join(self.cameras)}")

    def path(self, folder: Path, number: int) -> Path:
        """Where episode `number` goes."""
        return folder / f"{self.task.task_id.replace('/', '-')}_{self.seed + number:04d}.mcap"

    def scene(self, graphics: Graphics) -> Scene:
        """A scene to record in."""
        return Scene(
            self.task, assets=self.assets, graphics=graphics, cameras=self.cameras, picture_size=self.picture_size
        )

    def about(self, number: int, graphics: Graphics) -> dict[str, str]:
        """What is written in a recording of what made it."""
        return {
            "task": self.task.task_id,
            "seed": str(self.seed + number),
            "quality": f"{self.quality:g}",
            "disturbance": f"{self.disturbance:g}",
            "start": self.start,
            "assets": pack_name(self.assets),
            "cameras": " ".join(self.cameras if graphics.backend else ()),
            "picture_size": str(self.picture_size),
            "rate_hz": str(CONTROL_HZ),
            "goals": " ".join(itc.goal for itc in self.task.itcs),
        }


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recording, as its metadata has it."""

    path: Path
    seed: int
    steps: int
    success: bool
    elegant: bool
    cameras: tuple[str, ...]
    kept: bool
    """Whether it was there before this run."""


def record(
    plan: Plan,
    folder: Path,
    *,
    episodes: int,
    workers: int | None = None,
    graphics: Graphics | None = None,
    progress: Progress | None = None,
) -> list[Recorded]:
    """Record episodes 0 to `episodes` - 1 of a plan into `folder`, those that are not there yet.

    A recording has its name only once it is whole, so a stopped run goes on where it was. Without a GL library there
    are no pictures. Raises UsageError when the simulation cannot run here or a file of that name holds something else,
    SaveFailed when the disk refuses.
    """
    report = progress or (lambda _share, _what: None)
    if episodes < 1:
        raise UsageError(f"{episodes} episodes cannot be recorded; give 1 or more")
    if plan.task.bddl is None:
        raise UsageError(f"{plan.task.task_id} is not a task of simulation; `jiti tasks` lists all")
    find_robosuite()
    bddl_file(plan.task.bddl)
    pack_folder(plan.assets)
    expert_for(plan.task)
    graphics = graphics or (find_graphics() if plan.cameras else Graphics(None, "recording without pictures"))
    paths = [plan.path(folder, number) for number in range(episodes)]
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file; it must be a folder, which need not exist yet.")
    make_folder(folder)
    with alone(folder, "jiti record"):
        kept = {number for number, path in enumerate(paths) if _is_kept(path, plan, number, graphics)}
        missing = [number for number in range(episodes) if number not in kept]
        remove_leftovers(folder, [path.name for path in paths])
        report(0.0, graphics.message if plan.cameras else "recording without cameras")
        workers = min(workers or cores(), max(1, len(missing)))
        if workers == 1:
            _record_here(plan, folder, missing, graphics, report)
        else:
            _record_apart(plan, folder, missing, graphics, report, workers)
        report(1.0, f"{len(missing)} recorded, {len(kept)} kept")
    return [_recorded(path, number in kept) for number, path in enumerate(paths)]


def _record_here(plan: Plan, folder: Path, numbers: Sequence[int], graphics: Graphics, report: Progress) -> None:
    if not numbers:
        return
    with plan.scene(graphics) as scene:
        for done, number in enumerate(numbers):

            def step(count: int, done: int = done, number: int = number) -> None:
                share = (done + min(count / TYPICAL_STEPS, 1.0)) / len(numbers)
                report(share, f"recording {plan.path(folder, number).name}")

            _one(plan, folder, number, graphics, scene, step)


def _record_apart(
    plan: Plan, folder: Path, numbers: Sequence[int], graphics: Graphics, report: Progress, workers: int
) -> None:
    def name(number: int) -> str:
        return plan.path(folder, number).name

    done = in_processes(partial(_in_worker, plan, folder, graphics), numbers, workers, name)
    with closing(done):
        for count, (number, _) in enumerate(done, start=1):
            report(count / len(numbers), f"recorded {name(number)}")


_scenes: dict[tuple[Plan, Graphics], Scene] = {}
"""Of a worker, which serves one plan: building a scene takes as long as an episode."""


def _in_worker(plan: Plan, folder: Path, graphics: Graphics, number: int) -> None:
    if (plan, graphics) not in _scenes:
        scene = _scenes[plan, graphics] = plan.scene(graphics)
        Finalize(None, scene.close, exitpriority=1)  # what is registered with atexit is not called in a worker
    _one(plan, folder, number, graphics, _scenes[plan, graphics], lambda _count: check_stop())


def _one(
    plan: Plan, folder: Path, number: int, graphics: Graphics, scene: Scene, progress: Callable[[int], None]
) -> None:
    record_episode(
        plan.path(folder, number),
        scene,
        seed=plan.seed + number,
        quality=plan.quality,
        disturbance=plan.disturbance,
        start=plan.start,
        about=plan.about(number, graphics),
        progress=progress,
    )


def recorded_metadata(path: Path) -> Mapping[str, str]:
    """What the recorder wrote of itself in a recording: task, seed, quality, steps, outcome, ...

    Empty when it wrote nothing, or the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            records = [record.metadata for record in make_reader(file).iter_metadata() if record.name == METADATA_NAME]
    except (McapError, OSError):
        return {}
    return {key: value for record in records for key, value in record.items()}


def differing(found: Mapping[str, str], wanted: Mapping[str, str]) -> list[str]:
    """The keys of what a plan writes of itself whose values a recording's metadata does not have."""
    return [key for key, value in wanted.items() if found.get(key, _WITHOUT.get(key)) != value]


def _is_kept(path: Path, plan: Plan, number: int, graphics: Graphics) -> bool:
    if not path.exists():
        return False
    found, wanted = recorded_metadata(path), plan.about(number, graphics)
    if OUTCOME not in found:
        raise UsageError(f"{path} is another recording, and recordings are not replaced. Move that file away.")
    other = [
        f"{key} {found.get(key) or 'none'!r} and not {wanted[key] or 'none'!r}" for key in differing(found, wanted)
    ]
    if other:
        raise UsageError(
            f"{path} was recorded with {', '.join(other)}, and recordings are not replaced. "
            "Choose another folder with --out, or move that file away."
        )
    return True


def _recorded(path: Path, kept: bool) -> Recorded:
    found = recorded_metadata(path)
    outcome: dict[str, Any] = json.loads(found[OUTCOME])
    cameras = tuple(found["cameras"].split())
    return Recorded(path, int(found["seed"]), outcome["steps"], outcome["success"], outcome["elegant"], cameras, kept)


def print_recorded(recorded: Sequence[Recorded], folder: Path, *, as_json: bool = False) -> None:
    """Tell on standard output what is there now."""
    success = sum(one.success for one in recorded)
    elegant = sum(one.elegant for one in recorded)
    if as_json:
        episodes = [{**asdict(one), "path": str(one.path)} for one in recorded]
        told = {"folder": str(folder), "success": success, "elegant": elegant, "episodes": episodes}
        print(json.dumps(told, indent=2))
        return
    kept = sum(one.kept for one in recorded)
    print(f"{folder}: {len(recorded)} episodes, {success} successful, {elegant} elegant; {kept} were there before.")
    print(f"`jiti autolabel {folder}` proposes segments from the simulator, `jiti annotate {folder}` opens them.")
