"""Whether a critic puts the careful chunk before the careless one, where both begin in the same state.

    uv run python benchmarks/pairs.py CRITIC --episodes 12 --json figures.json

A demonstration with care and one without, of the same seed, are the same until they part. The chunks of both that begin
at that frame, and 2, 4 and 6 before, are valued at the state that they share. Pairs count of which the careful one came
out elegant and the careless one did not. What is guessed has 0.5. How far the critic has to look ahead tells the time
from the parting to the step at which the simulator decides the careful one's constraints.
"""

import argparse
import json
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing
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
"""First seed: no plan of the benchmark has one from 310000 to 399999."""
BEFORE = (0, 2, 4, 6)
"""Frames before the parting at which chunks begin; the critic's are longer."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """What a critic made of a task's pairs."""

    task: str
    first: int
    """In how many the careful chunk is worth more."""
    of: int
    seeds: int
    """Of which both demonstrations came out as they were meant."""
    ahead_steps: float | None
    """From the parting to the verdict on the careful demonstration, the mean of them."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A demonstration: (T + 1) observations, (T, 7) actions."""

    observations: "list[Observation]"
    actions: np.ndarray
    elegant: bool
    decided_at: int
    """The step at which the last of its constraints was decided."""


def measure(critic: str, task: str, assets: str, seeds: Sequence[int]) -> Pairs:
    """Demonstrate each seed twice, and ask the critic."""
    import torch

    from jiti.runtime.candidates import open_scorer
    from jiti.runtime.sim.env import ElegantEnv

    torch.set_num_threads(1)
    scorer = open_scorer(critic)
    first, of, ahead = 0, 0, []
    with closing(ElegantEnv(task, assets=assets)) as env:
        for seed in seeds:
            careful, careless = show(env, seed, careful=True), show(env, seed, careful=False)
            if not careful.elegant or careless.elegant:
                continue
            part = parting(careful.actions, careless.actions)
            ahead.append(careful.decided_at - part)
            for frame in (part - before for before in BEFORE if part >= before):
                chunks = [shown.actions[frame : frame + scorer.chunk] for shown in (careful, careless)]
                if min(map(len, chunks)) < scorer.chunk:
                    continue
                state = careful.observations[frame]
                for key, value in careless.observations[frame].items():
                    np.testing.assert_array_equal(value, state[key], f"{task}, seed {seed}: they part before they act")
                good, bad = scorer.at(state, env.task_description)(np.stack(chunks))
                first += bool(good > bad)
                of += 1
    return Pairs(task, first, of, len(ahead), fmean(ahead) if ahead else None)


def show(env: "ElegantEnv", seed: int, *, careful: bool) -> Shown:
    """The demonstration of a seed."""
    from jiti.runtime.rollout.play import lerobot_keys
    from jiti.runtime.sim.demonstrators import demonstrator_for
    from jiti.runtime.sim.episode import run_episode

    observations, actions = [], []

    def watch(_step: int, action: np.ndarray | None) -> None:
        observations.append(lerobot_keys(env.observe()))
        if action is not None:
            actions.append(action)

    env.reset(seed=seed)
    outcome = run_episode(env.monitor, demonstrator_for(env.scene, seed, float(careful)), env.scene.step, watch)
    decided_at = max(verdict.step for verdict in outcome.verdicts.values())
    return Shown(observations, np.array(actions), outcome.elegant, decided_at)


def parting(one: np.ndarray, other: np.ndarray) -> int:
    """The first frame at which actions (T, 7) and (T', 7) differ."""
    both = min(len(one), len(other))
    apart = np.flatnonzero((one[:both] != other[:both]).any(1))
    return int(apart[0]) if len(apart) else both


def table_of(found: Sequence[Pairs]) -> Table:
    """A row for each task, and one for all."""
    table = Table(title="The careful chunk is worth more, at the state where both begin", title_justify="left")
    for name in ("task", "share", "of", "seeds", "steps to the verdict"):
        table.add_column(name, justify="left" if name == "task" else "right")
    for pairs in found:
        share = f"{pairs.first / pairs.of:.2f}" if pairs.of else "-"
        table.add_row(pairs.task, share, str(pairs.of), str(pairs.seeds), _steps(pairs.ahead_steps))
    first, of = sum(pairs.first for pairs in found), sum(pairs.of for pairs in found)
    table.add_section()
    table.add_row("all", f"{first / of:.2f}" if of else "-", str(of), str(sum(pairs.seeds for pairs in found)), "")
    return table


def _steps(count: float | None) -> str:
    return "-" if count is None else f"{count:.0f}"


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
