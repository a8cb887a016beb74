"""One episode continued in several ways from its first trigger: the case study of supplement F.1.

Each way applies its own pick at every trigger. Until the first they are one and the same, because an initial state and
the noise of chunks follow from the seed: so each is simply played from the start, and that they agree is checked.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jiti.episodes.episode import Episode, ImageBatch, samples
from jiti.episodes.reader import open_reader
from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.runtime.rollout.agent import OpenAgent, open_agent
from jiti.runtime.rollout.drawing import Branch, write_branches
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.runtime.rollout.result import Rollout, load_result, outcome_text, without_nan
from jiti.runtime.rollout.run import (
    Job,
    check_simulation,
    close_all,
    enter_jobs,
    graphics_for,
    is_whole,
    make_out,
    play_job,
    tabulate,
)
from jiti.runtime.workers import alone

_OBJECTS = "/objects/"


@dataclass(frozen=True, slots=True)
class Branched:
    """What came of it. Its text is for a person."""

    seed: int
    frame: int
    """Step of the first trigger, until which all are the same."""
    rollouts: tuple[Rollout, ...]
    recording: Path
    """An .rrd."""
    cameras: tuple[str, ...]

    def __str__(self) -> str:
        first = self.rollouts[0].choices
        choice = next(c for c in first if c.triggered)
        lines = [
            f"seed {self.seed}: one episode until step {self.frame}, where Q of the default, {choice.q_t:.3f}, was "
            f"{choice.delta_q:.3f} away from the mean before it",
            *(f"  {r.pick}: {outcome_text(r)}, {r.interventions} interventions" for r in self.rollouts),
            f"`rerun {self.recording}` shows them side by side"
            + ("." if self.cameras else ", without pictures, for want of a GL library."),
        ]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        rows = [{"pick": r.pick, "success": r.success, "elegant": r.elegant, "steps": r.steps} for r in self.rollouts]
        verdicts = [{"itcs": {itc: asdict(verdict) for itc, verdict in r.itcs}} for r in self.rollouts]
        branches = [row | own for row, own in zip(rows, verdicts, strict=True)]
        return {"seed": self.seed, "frame": self.frame, "recording": str(self.recording), "branches": branches}


def branch(
    plan: RolloutPlan,
    folder: Path,
    *,
    episodes: int,
    progress: Progress | None = None,
    make_agent: OpenAgent = open_agent,
) -> Branched:
    """Play the first of `episodes` episodes in which JITI triggers once for each of the plan's guidances, which differ
    in their pick alone, and write them to `folder` side by side. What is there already is kept.

    Raises UsageError where nothing triggers, or the simulator does not repeat itself.
    """
    report = progress or (lambda _share, _what: None)
    check_simulation(plan)
    graphics = graphics_for(plan)
    make_out(folder)
    with alone(folder, "jiti rollout"):
        jobs = enter_jobs(plan, folder, range(episodes), record=True, graphics=graphics, make_agent=make_agent)
        try:
            branches = _branches(jobs, report)
            rollouts = [_played(branches[0])]
            for place, job in enumerate(branches[1:], start=1):
                report(place / len(branches), f"playing seed {job.seed}, {job.label}")
                rollouts.append(_played(job))
        finally:
            close_all()
            tabulate(folder)
    first = rollouts[0]
    frame = _same_until(rollouts)
    recording = folder / f"{branches[0].recording.stem}.rrd"
    drawn = {r.pick: _drawn(job.recording, r) for r, job in zip(rollouts, branches, strict=True)}
    write_branches(recording, drawn, cameras=bool(plan.cameras))
    return Branched(first.seed, frame, tuple(rollouts), recording, plan.cameras)


def _played(job: Job) -> Rollout:
    return load_result(job.result) if is_whole(job) else play_job(job)


def _branches(jobs: Sequence[Job], report: Progress) -> list[Job]:
    """The jobs of the first episode that triggers. Raises UsageError where none does."""
    first, plan = jobs[0].label, jobs[0].plan
    for job in jobs:
        if job.label == first:
            report(0.0, f"playing seed {job.seed}, until one triggers")
            if _played(job).interventions:
                return [other for other in jobs if other.number == job.number]
    raise UsageError(
        f"nothing triggered in {len(jobs) // len(plan.labels)} episodes from seed {plan.seed}. Lower the threshold "
        "with --tau-scale 0.5, or play more with --episodes."
    )


def _same_until(rollouts: Sequence[Rollout]) -> int:
    """Step of the first trigger. Raises UsageError where the ways differ before it."""
    place = next(k for k, choice in enumerate(rollouts[0].choices) if choice.triggered)
    # Where the critic gave no number, that is the same: NaN does not equal itself.
    seen = [without_nan([(c.frame, c.q_t, c.values) for c in r.choices[: place + 1]]) for r in rollouts]
    if any(other != seen[0] for other in seen[1:]):
        raise UsageError(
            f"seed {rollouts[0].seed} went differently before its first trigger: something here does not repeat "
            "itself. Play on the CPU with --device cpu, and delete the folder of branches."
        )
    return rollouts[0].choices[place].frame


def _drawn(path: Path, rollout: Rollout) -> Branch:
    reader = open_reader(path)
    episode = reader.open(reader.episodes()[0].episode_id)
    objects = [name for name in episode.streams if name.startswith(_OBJECTS)]
    found = samples(episode, ["/eef_pose", *objects])
    things = {name.removeprefix(_OBJECTS): found[name][1][:, :3] for name in objects}
    q = [(choice.frame, choice.q_t, choice.triggered) for choice in rollout.choices if np.isfinite(choice.q_t)]
    return Branch(outcome_text(rollout), found["/eef_pose"][1][:, :3], things, _pictures(episode), q)


def _pictures(episode: Episode) -> list[bytes]:
    """Of its first camera; none without one."""
    cameras = [name for name, stream in episode.streams.items() if stream.kind == "camera"]
    if not cameras:
        return []
    batches = episode.read(cameras[:1])
    return [bytes(data) for batch in batches if isinstance(batch, ImageBatch) for data in batch.data]
