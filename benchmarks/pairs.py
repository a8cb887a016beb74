"""Whether a critic puts the careful chunk before the careless one, where both begin in the same state.

    uv run python benchmarks/pairs.py CRITIC --episodes 12 --json figures.json

A demonstration with care and one without, of the same seed, are the same until they part. The chunks of both that begin
at that frame, and 2, 4 and 6 before, are valued at the state that they share. Pairs count of which the careful one came
out elegant and the careless one did not. What is guessed has 0.5. How long after the parting the careful demonstration
ends tells how far the critic has to look ahead.
"""

import argparse
import json
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from jiti.runtime.candidates.observation import Observation
    from jiti.runtime.sim.env import ElegantEnv

ELEGANT = tuple(f"elegant/T{k}" for k in range(8))
SEED = 310_000
"""First seed: the benchmark's plans neither record, nor calibrate, nor play from here on."""
BEFORE = (0, 2, 4, 6)
"""Frames before the parting at which chunks begin; the critic's are longer."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """What a critic made of a task's pairs."""

    task: str
    first: int
    """In how many the careful chunk is worth more."""
    of: int
    ahead: float | None
    """Frames from the parting to the end of the careful demonstration, the mean of them."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A demonstration: (T + 1) observations, (T, 7) actions."""

    observations: "list[Observation]"
    actions: np.ndarray
    elegant: bool


def measure(critic: str, task: str, assets: str, seeds: Sequence[int]) -> Pairs:
    """Demonstrate each seed twice, and ask the critic."""
    import torch

    from jiti.runtime.candidates import open_scorer
    from jiti.runtime.sim.env import ElegantEnv

    torch.set_num_threads(1)
    scorer = open_scorer(critic)
    env = ElegantEnv(task, assets=assets)
    first, of, ahead = 0, 0, []
    for seed in seeds:
        careful, careless = show(env, seed, careful=True), show(env, seed, careful=False)
        if not careful.elegant or careless.elegant:
            continue
        part = parting(careful.actions, careless.actions)
        ahead.append(len(careful.actions) - part)
        for frame in (part - before for before in BEFORE if part >= before):
            chunks = [shown.actions[frame : frame + scorer.chunk] for shown in (careful, careless)]
            if min(map(len, chunks)) < scorer.chunk:
                continue
            good, bad = scorer.at(careful.observations[frame], env.task_description)(np.stack(chunks))
            first += bool(good > bad)
            of += 1
    env.close()
    return Pairs(task, first, of, fmean(ahead) if ahead else None)


def show(env: "ElegantEnv", seed: int, *, careful: bool) -> Shown:
    """The demonstration of a seed."""
    from jiti.runtime.rollout.play import lerobot_keys
    from jiti.runtime.sim.demonstrators import demonstrator_for

    seen, _ = env.reset(seed=seed)
    actor = demonstrator_for(env.scene, seed, float(careful))
    observations, actions = [lerobot_keys(seen)], []
    while (action := actor.act()) is not None:
        seen, *_ = env.step(action)
        actions.append(action)
        observations.append(lerobot_keys(seen))
    outcome = env.monitor.outcome()
    return Shown(observations, np.array(actions), outcome.success and outcome.elegant)


def parting(one: np.ndarray, other: np.ndarray) -> int:
    """The first frame at which actions (T, 7) and (T', 7) differ."""
    both = min(len(one), len(other))
    apart = np.flatnonzero((one[:both] != other[:both]).any(1))
    return int(apart[0]) if len(apart) else both


def table_of(found: Sequence[Pairs]) -> Table:
    """A row for each task, and one for all."""
    table = Table(title="The careful chunk is worth more, at the state where both begin", title_justify="left")
    for name in ("task", "share", "of", "frames to the end"):
        table.add_column(name, justify="left" if name == "task" else "right")
    for pairs in found:
        share = f"{pairs.first / pairs.of:.2f}" if pairs.of else "-"
        table.add_row(pairs.task, share, str(pairs.of), "-" if pairs.ahead is None else f"{pairs.ahead:.0f}")
    first, of = sum(pairs.first for pairs in found), sum(pairs.of for pairs in found)
    table.add_section()
    table.add_row("all", f"{first / of:.2f}" if of else "-", str(of), "")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("critic", metavar="CRITIC", help="a run of train-critic, or a Hub id")
    parser.add_argument("--task", action="append", help="may be repeated (default: elegant/T0 to T7)")
    parser.add_argument("--episodes", type=int, default=12, help="seeds a task")
    parser.add_argument("--seed", type=int, default=SEED, help=f"the first (default: {SEED})")
    parser.add_argument("--assets", default="primitive", help="primitive, libero, or a folder")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here as well")
    asked = parser.parse_args()
    seeds = range(asked.seed, asked.seed + asked.episodes)
    tasks = asked.task or ELEGANT
    console, found = Console(), {}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=context) as pool:
        jobs = {pool.submit(measure, asked.critic, task, asked.assets, seeds): task for task in tasks}
        for job in as_completed(jobs):
            found[jobs[job]] = job.result()
            print(f"{jobs[job]}: done", flush=True)
    rows = [found[task] for task in tasks]
    console.print(table_of(rows))
    if asked.json:
        told = {"critic": asked.critic, "seeds": list(seeds), "tasks": [asdict(row) for row in rows]}
        asked.json.write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
