"""Many episodes on all cores, going on where a run was stopped; the same initial states for every way of guiding."""

import multiprocessing
from collections.abc import Generator, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, field
from multiprocessing.util import Finalize
from pathlib import Path
from time import perf_counter
from typing import Any

from jiti.annotate.engine import cores
from jiti.durable import make_folder
from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.agent import Agent, OpenAgent, open_agent
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.runtime.rollout.plan_file import enter_plan, read_plan
from jiti.runtime.rollout.play import Watcher, lerobot_keys, play
from jiti.runtime.rollout.recorder import Recorder
from jiti.runtime.rollout.result import (
    RECORDING_SUFFIX,
    RESULT_SUFFIX,
    Rollout,
    load_result,
    rollout_of,
    save_result,
    write_tables,
)
from jiti.runtime.sim.engine import find_robosuite
from jiti.runtime.sim.env import ElegantEnv
from jiti.runtime.sim.gl import Graphics, find_graphics
from jiti.runtime.sim.libero import bddl_file, pack_folder, pack_name
from jiti.runtime.sim.scene import CONTROL_HZ
from jiti.runtime.workers import alone, check_stop, in_processes, remove_leftovers


@dataclass(frozen=True)
class Job:
    """Episode `number` of a plan, guided in one way."""

    plan: RolloutPlan
    folder: Path
    label: str
    number: int
    record: bool
    graphics: Graphics
    make_agent: OpenAgent = open_agent
    marks: tuple[tuple[str, str], ...] = ()
    """Fingerprints of what plays, for the recording."""

    @property
    def seed(self) -> int:
        return self.plan.seed + self.number

    @property
    def result(self) -> Path:
        """The file that is there once the episode is whole."""
        return self.folder / self.label / f"{self.plan.stem(self.number)}{RESULT_SUFFIX}"

    @property
    def recording(self) -> Path:
        return self.result.with_suffix(RECORDING_SUFFIX)

    def about(self) -> dict[str, str]:
        """What is written in the recording of what made it: no path of this machine."""
        guidance = self.plan.guidance(self.label)
        return {
            "task": self.plan.task.task_id,
            "start": self.plan.start,
            "assets": pack_name(self.plan.assets),
            "rate_hz": str(CONTROL_HZ),
            "seed": str(self.seed),
            "goals": " ".join(itc.goal for itc in self.plan.task.itcs),
            "cameras": " ".join(self.plan.cameras),
            "guidance": self.label,
            **({"tau": f"{guidance.tau:g}"} if guidance.tau is not None else {}),
            **dict(self.marks),
        }


def run_rollouts(
    plan: RolloutPlan,
    folder: Path,
    *,
    episodes: int,
    workers: int | None = None,
    record: bool = True,
    progress: Progress | None = None,
    make_agent: OpenAgent = open_agent,
) -> list[Rollout]:
    """Play episodes 0 to `episodes` - 1 of a plan for each of its guidances, those that are not in `folder` yet.

    An episode counts once it is whole, so a stopped or killed run goes on where it was; `folder` then has the tables of
    all rollouts that are there, also after an error. With one worker all is played in this process. Given back are
    the rollouts that were asked for, in the order of guidances, then seeds.

    Raises UsageError when the simulation cannot run here, the folder holds rollouts of another plan, or a worker was
    ended from outside (it names the episode); SourceError when policy or critic cannot be opened; SaveFailed when the
    disk refuses.
    """
    report = progress or (lambda _share, _what: None)
    if episodes < 1:
        raise UsageError(f"{episodes} episodes cannot be played; give 1 or more")
    check_simulation(plan)
    graphics = graphics_for(plan)
    make_out(folder)
    with alone(folder, "jiti rollout"):
        jobs = enter_jobs(plan, folder, range(episodes), record=record, graphics=graphics, make_agent=make_agent)
        missing = [job for job in jobs if not is_whole(job)]
        report((len(jobs) - len(missing)) / len(jobs), f"{len(missing)} episodes to play")
        try:
            with closing(_played(missing, min(workers or cores(), max(1, len(missing))))) as done:
                for count, job in enumerate(done, start=1):
                    share = (len(jobs) - len(missing) + count) / len(jobs)
                    report(share, f"played {job.label} {job.plan.stem(job.number)}")
        except BaseException:
            # What stopped it is told, and not what writing tables, which imports pandas, then stumbles over.
            with suppress(Exception):
                tabulate(folder)
            raise
        tabulate(folder)
    return results(jobs)


def make_out(folder: Path) -> None:
    """Make the folder of `--out`, or one in it. Raises UsageError where a file is in its place, SaveFailed."""
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise UsageError(f"--out {place} is a file; it must be a folder, which need not exist yet.")
    make_folder(folder)


def enter_jobs(
    plan: RolloutPlan, folder: Path, numbers: Sequence[int], *, record: bool, graphics: Graphics, make_agent: OpenAgent
) -> list[Job]:
    """The episodes of a plan in a folder that no other run is at work in, and a folder for each guidance.

    By episode first, so that where a run is stopped, the guidances have their episodes in common. Raises UsageError
    when the folder holds rollouts of another plan.
    """
    entered = enter_plan(folder, plan)
    jobs = []
    for number in numbers:
        for label in plan.labels:
            found = {"policy": entered["shared"]["policy"], "critic": entered["methods"][label].get("critic")}
            marks = tuple((key, value) for key, value in found.items() if value)
            jobs.append(Job(plan, folder, label, number, record, graphics, make_agent, marks))
    for label in plan.labels:
        make_folder(folder / label)
        own = [job for job in jobs if job.label == label]
        remove_leftovers(folder / label, [path.name for job in own for path in (job.result, job.recording)])
    return jobs


def results(jobs: Sequence[Job]) -> list[Rollout]:
    """What was kept of these episodes, in the order of guidances, then seeds. Raises SourceError."""
    order = {label: place for place, label in enumerate(jobs[0].plan.labels)}
    return [load_result(job.result) for job in sorted(jobs, key=lambda job: (order[job.label], job.number))]


def check_simulation(plan: RolloutPlan) -> None:
    """Raises UsageError when what a plan needs of the simulator is not installed."""
    find_robosuite()
    assert plan.task.bddl is not None
    bddl_file(plan.task.bddl)
    pack_folder(plan.assets)


def graphics_for(plan: RolloutPlan) -> Graphics:
    """How pictures are rendered here. Raises UsageError when the plan has cameras and nothing renders."""
    if not plan.cameras:
        return Graphics(None, "no cameras were asked for")
    graphics = find_graphics()
    if graphics.backend is None:
        raise UsageError(f"--cameras {','.join(plan.cameras)}: {graphics.message}")
    return graphics


def is_whole(job: Job) -> bool:
    """Whether an episode need not be played again. Raises SourceError for a result that cannot be read."""
    return job.result.exists() and load_result(job.result) is not None and (not job.record or job.recording.exists())


def all_rollouts(folder: Path) -> list[Rollout]:
    """Every whole rollout of a folder, by guidance, then seed. Raises SourceError."""
    labels = sorted(read_plan(folder)["methods"])
    return [load_result(path) for label in labels for path in sorted((folder / label).glob(f"[!.]*{RESULT_SUFFIX}"))]


def tabulate(folder: Path) -> None:
    """Write the tables of every whole rollout of a folder. Raises SourceError, SaveFailed."""
    entered = read_plan(folder)
    played_by = {
        label: {"policy": entered["shared"]["policy"], "critic": settings.get("critic")}
        for label, settings in entered["methods"].items()
    }
    write_tables(folder, all_rollouts(folder), played_by)


def play_job(job: Job, watchers: Sequence[Watcher] = ()) -> Rollout:
    """Play an episode in this process and keep it: the recording first, then the result, which makes it whole."""
    began = perf_counter()
    env, agent = _opened(job)
    guidance: Guidance = job.plan.guidance(job.label)
    watching = [_Stopper(), *watchers]
    recorder = Recorder(job.recording, job.plan.task.instruction, job.about()) if job.record else None
    with recorder or nullcontext():
        played = play(env, agent, guidance, job.seed, [*watching, recorder] if recorder else watching)
        if recorder:
            recorder.finish(played.outcome)
    rollout = rollout_of(job.plan.task.task_id, guidance, job.seed, played, perf_counter() - began)
    save_result(job.result, rollout)
    return rollout


def _played(jobs: Sequence[Job], workers: int) -> Generator[Job]:
    if workers == 1:
        try:
            for job in jobs:
                play_job(job)
                yield job
        finally:
            close_all()
        return
    with closing(in_processes(_in_worker, jobs, workers, _name)) as done:
        for job, _ in done:
            yield job


def _name(job: Job) -> str:
    return f"{job.label}/{job.plan.stem(job.number)} (seed {job.seed})"


def _in_worker(job: Job) -> None:
    play_job(job)


class _Stopper(Watcher):
    """Ends an episode that no one waits for any more."""

    def stepped(self, env: ElegantEnv, step: int, seen: dict[str, Any], action: Any) -> None:
        check_stop()


@dataclass
class _Open:
    """Of this process, which plays one plan at a time: building a scene takes as long as an episode."""

    plan: RolloutPlan
    graphics: Graphics
    make_agent: OpenAgent
    env: ElegantEnv
    agent: Agent = field(init=False)


_open: _Open | None = None


def _opened(job: Job) -> tuple[ElegantEnv, Agent]:
    global _open
    if _open is None or (_open.plan, _open.graphics, _open.make_agent) != (job.plan, job.graphics, job.make_agent):
        close_all()
        plan = job.plan
        env = ElegantEnv(
            plan.task,
            cameras=plan.cameras,
            assets=plan.assets,
            start=plan.start,
            max_episode_steps=plan.most_steps,
            graphics=job.graphics,
        )
        _open = _Open(plan, job.graphics, job.make_agent, env)
        if multiprocessing.parent_process() is not None:
            Finalize(None, close_all, exitpriority=1)  # what is registered with atexit is not called in a worker
        seen, _ = env.reset(seed=job.seed)
        _open.agent = job.make_agent(plan, lerobot_keys(seen))
    return _open.env, _open.agent


def close_all() -> None:
    """Close the scene that this process has open: a renderer that is open when Python ends prints errors."""
    global _open
    if _open is not None:
        _open.env.close()
        _open = None
