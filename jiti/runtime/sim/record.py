"""`jiti record`: demonstrations of one task as a folder of recordings, on all cores, going on where it was stopped."""

import fcntl
import json
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from multiprocessing.process import BaseProcess
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
from jiti.runtime.sim.libero import PRIMITIVE, bddl_file, pack_folder
from jiti.runtime.sim.record_episode import OUTCOME, record_episode
from jiti.runtime.sim.scene import CAMERAS, CONTROL_HZ, Scene, Start
from jiti.tasks.task import Task

TYPICAL_STEPS = 200
"""Steps of an episode, for progress alone."""
GRACE_S = 5.0
"""Our choice: a step with pictures takes 0.3 s on a slow machine."""


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

    def __post_init__(self) -> None:
        if not 0 <= self.quality <= 1:
            raise UsageError(f"--quality {self.quality:g} is not in 0 to 1")
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
            "start": self.start,
            "assets": self.pack_name,
            "cameras": " ".join(self.cameras if graphics.backend else ()),
            "picture_size": str(self.picture_size),
            "rate_hz": str(CONTROL_HZ),
            "goals": " ".join(itc.goal for itc in self.task.itcs),
        }

    @property
    def pack_name(self) -> str:
        """Of the asset pack; of a folder its own name, so that no path of this machine gets into a recording."""
        folder = pack_folder(self.assets)
        return "libero" if folder is None else "primitive" if folder == PRIMITIVE else f"{folder.name}/"


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
    with _alone(folder):
        kept = {number for number, path in enumerate(paths) if _is_kept(path, plan, number, graphics)}
        missing = [number for number in range(episodes) if number not in kept]
        _remove_leftovers(folder, paths)
        report(0.0, graphics.message if plan.cameras else "recording without cameras")
        workers = min(workers or cores(), max(1, len(missing)))
        if workers == 1:
            _record_here(plan, folder, missing, graphics, report)
        else:
            _record_apart(plan, folder, missing, graphics, report, workers)
        report(1.0, f"{len(missing)} recorded, {len(kept)} kept")
    return [_recorded(path, number in kept) for number, path in enumerate(paths)]


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder until the end; the system lets it go when this process ends, however it ends."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise UsageError(f"another `jiti record` is at work in {folder}. Wait for it, or pass another --out.") from None
    try:
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


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
    """In processes of their own: MuJoCo holds the interpreter, and its renderers do not survive a fork."""
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(stop,)) as pool:
        with _ignoring_interrupts():  # which workers inherit: Ctrl-C reaches every process of a terminal
            jobs = {pool.submit(_in_worker, plan, folder, number, graphics): number for number in numbers}
        try:
            for done, job in enumerate(as_completed(jobs), start=1):
                job.result()
                report(done / len(numbers), f"recorded {plan.path(folder, jobs[job]).name}")
        except BrokenProcessPool as error:
            raise UsageError(
                "a recording process was ended from outside, perhaps for want of memory. What is finished is kept: run "
                "the same command again, with fewer --workers."
            ) from error
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            _end_soon(multiprocessing.active_children())
            raise


def _end_soon(workers: Sequence[BaseProcess]) -> None:
    """Give each worker a moment to take its unfinished file away, and end those that build a scene meanwhile."""
    end = time.monotonic() + GRACE_S
    for worker in workers:
        worker.join(max(0.0, end - time.monotonic()))
        if worker.is_alive():
            worker.terminate()


class _Stopped(Exception):
    """Ends a recording that no one waits for any more."""


_stop: Any = None
_scenes: dict[tuple[Plan, Graphics], Scene] = {}
"""Of a worker, which serves one plan: building a scene takes as long as an episode."""


def _begin_worker(stop: Any) -> None:
    global _stop
    _stop = stop
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """When the process that asked was killed, no one takes work from this one or ends it: finish here."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        _stop.set()
        time.sleep(GRACE_S)  # in which an episode that is being recorded takes its unfinished file away
        os._exit(1)


def _in_worker(plan: Plan, folder: Path, number: int, graphics: Graphics) -> None:
    def step(_count: int) -> None:
        if _stop.is_set():
            raise _Stopped

    if (plan, graphics) not in _scenes:
        scene = _scenes[plan, graphics] = plan.scene(graphics)
        Finalize(None, scene.close, exitpriority=1)  # what is registered with atexit is not called in a worker
    _one(plan, folder, number, graphics, _scenes[plan, graphics], step)


def _one(
    plan: Plan, folder: Path, number: int, graphics: Graphics, scene: Scene, progress: Callable[[int], None]
) -> None:
    record_episode(
        plan.path(folder, number),
        scene,
        seed=plan.seed + number,
        quality=plan.quality,
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


def _is_kept(path: Path, plan: Plan, number: int, graphics: Graphics) -> bool:
    if not path.exists():
        return False
    found, wanted = recorded_metadata(path), plan.about(number, graphics)
    if OUTCOME not in found:
        raise UsageError(f"{path} is another recording, and recordings are not replaced. Move that file away.")
    other = [
        f"{key} {found.get(key) or 'none'!r} and not {value or 'none'!r}"
        for key, value in wanted.items()
        if found.get(key) != value
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


def _remove_leftovers(folder: Path, paths: Sequence[Path]) -> None:
    """Unfinished files of runs that were killed; no run goes on in this folder now."""
    names = {path.name for path in paths}
    for path in folder.glob(".tmp-*.mcap"):
        found = re.fullmatch(r"\.tmp-(\d+)-[0-9a-f]+-(.+)", path.name)
        if found and found[2] in names:
            with suppress(OSError):
                path.unlink()


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
