"""`jiti rollout --live`: episodes shown in Rerun while they are played, one after another in this process."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.runtime.rollout.agent import OpenAgent, open_agent
from jiti.runtime.rollout.decide import Decided
from jiti.runtime.rollout.drawing import draw_decision, draw_state, live_recording
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.runtime.rollout.play import Watcher
from jiti.runtime.rollout.result import Rollout, outcome_text
from jiti.runtime.rollout.run import (
    check_simulation,
    close_all,
    enter_jobs,
    graphics_for,
    is_whole,
    make_out,
    play_job,
    results,
    tabulate,
)
from jiti.runtime.rollout.viewer import Viewer
from jiti.runtime.sim.env import ElegantEnv
from jiti.runtime.sim.pictures import jpeg
from jiti.runtime.workers import alone

if TYPE_CHECKING:
    import rerun as rr

SHOWN_SUFFIX = ".rrd"
"""Of the files, beside the recordings, that hold what was shown; `rerun` opens them again."""


class LiveWatcher(Watcher):
    """Draws an episode as it goes; each has a recording of its own."""

    def __init__(self, recording: "rr.RecordingStream", tau: float | None) -> None:
        self._recording, self._tau = recording, tau
        self._path: list[np.ndarray] = []

    def decided(self, env: ElegantEnv, decided: Decided) -> None:
        draw_decision(self._recording, decided, self._tau, env.scene.world_T_eef[:3, 3])

    def stepped(self, env: ElegantEnv, step: int, seen: dict[str, Any], action: np.ndarray | None) -> None:
        world = env.scene.world
        hand = env.scene.world_T_eef[:3, 3].copy()
        self._path.append(hand)
        things = {name: world.position(name) for name in world.names.objects}
        pictures = {camera: jpeg(picture) for camera, picture in seen.get("pixels", {}).items()}
        draw_state(self._recording, step, hand, self._path, things, pictures)


def watch_live(
    plan: RolloutPlan,
    folder: Path,
    *,
    episodes: int,
    record: bool = True,
    say: Callable[[str], None] = print,
    make_agent: OpenAgent = open_agent,
    viewer: bool = True,
) -> list[Rollout]:
    """Play a plan as `run_rollouts` does, one episode at a time, and show each that is not there yet.

    Where there is a display, Rerun's own viewer opens; else `say` is told the address of one for a browser. What was
    shown is kept as an .rrd beside each result; without `viewer` only that is made. Raises UsageError when no viewer
    starts.
    """
    check_simulation(plan)
    graphics = graphics_for(plan)
    make_out(folder)
    with alone(folder, "jiti rollout"):
        jobs = enter_jobs(plan, folder, range(episodes), record=record, graphics=graphics, make_agent=make_agent)
        missing = [job for job in jobs if not is_whole(job)]
        shown = Viewer(say) if viewer and missing else None
        try:
            for job in missing:
                path = job.result.with_suffix(SHOWN_SUFFIX)
                to = shown.address if shown else None
                with live_recording(f"{job.label}, seed {job.seed}", plan.cameras, path, to) as recording:
                    rollout = play_job(job, [LiveWatcher(recording, plan.guidance(job.label).tau)])
                say(f"{job.label}, seed {job.seed}: {outcome_text(rollout)}; {path} shows it again")
            if shown:
                shown.wait()
        finally:
            close_all()
            tabulate(folder)
            if shown:
                shown.close()
    return results(jobs)
