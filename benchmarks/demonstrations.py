"""How often scripted demonstrations succeed and are elegant, and what one costs: a table over tasks, packs, qualities.

    uv run python benchmarks/demonstrations.py --episodes 50 --assets primitive --assets DIR

Every cell has the same seeds, which no expert was tuned on; which of them are meant to be elegant is spread evenly over
seeds. Time is wall time of one episode while all cores are busy, reset and predicates included; beside it the same as a
multiple of what the control steps alone took, which are the peer.
"""

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from itertools import batched
from pathlib import Path
from statistics import fmean
from typing import Any

from rich.console import Console
from rich.table import Table

ELEGANT = tuple(f"elegant/T{k}" for k in range(8))
EPISODES_A_PROCESS = 25
"""So that all cores stay busy; building a scene takes as long as two or three episodes."""
SEED = 1000
"""First seed. Experts were written with seeds below 200."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Episodes of one task with one pack: seeds, and whether each is meant to be elegant."""

    task: str
    assets: str
    episodes: tuple[tuple[int, bool], ...]


@dataclass(frozen=True, slots=True)
class Episode:
    """What came out of one episode."""

    success: bool
    elegant: bool
    steps: int
    seconds: float
    step_seconds: float
    """Of the control steps alone."""


@dataclass(frozen=True, slots=True)
class Figures:
    """One task with one pack at one quality."""

    task: str
    assets: str
    quality: float
    episodes: int
    success: int
    elegant: int
    steps: float
    """Mean of an episode."""
    seconds: float
    """Mean of an episode."""
    step_seconds: float
    """Mean of an episode's control steps alone."""


def measure(runs: Runs) -> dict[tuple[int, bool], Episode]:
    """Demonstrate each of them."""
    from jiti.runtime.sim.demonstrators import demonstrator_for
    from jiti.runtime.sim.episode import run_episode
    from jiti.runtime.sim.monitor import Monitor
    from jiti.runtime.sim.scene import Scene
    from jiti.tasks.catalogue import load_catalogue

    found = {}
    with Scene(load_catalogue().simulated(runs.task), assets=runs.assets) as scene:
        for seed, careful in runs.episodes:
            begin, spent = time.perf_counter(), [0.0]

            def step(action: Any, spent: list[float] = spent) -> None:
                before = time.perf_counter()
                scene.step(action)
                spent[0] += time.perf_counter() - before

            scene.reset(seed)
            outcome = run_episode(Monitor(scene), demonstrator_for(scene, seed, float(careful)), step)
            seconds = time.perf_counter() - begin
            found[seed, careful] = Episode(outcome.success, outcome.elegant, outcome.steps, seconds, spent[0])
    return found


def main() -> None:
    from jiti.runtime.sim.demonstrators import is_careful

    asked = _arguments()
    console = Console(stderr=True)
    seeds = tuple(range(asked.seed, asked.seed + asked.episodes))
    tasks, packs = asked.task or ELEGANT, asked.assets or ["primitive"]
    cells = [
        (task, pack, q) for task in tasks for pack in packs for q in (asked.quality if pack == packs[0] else [0.5])
    ]
    # An episode is the same in every cell that has its seed and its intent, so each is run once.
    wanted: dict[tuple[str, str], dict[tuple[int, bool], None]] = {}
    for task, pack, quality in cells:
        wanted.setdefault((task, pack), {}).update({(seed, is_careful(seed, quality)): None for seed in seeds})
    start = time.monotonic()
    found: dict[tuple[str, str], dict[tuple[int, bool], Episode]] = {}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=context, max_tasks_per_child=1) as pool:
        jobs = {
            pool.submit(measure, Runs(*key, tuple(some))): key
            for key, episodes in wanted.items()
            for some in batched(episodes, EPISODES_A_PROCESS)
        }
        for job in as_completed(jobs):
            done = job.result()
            found.setdefault(jobs[job], {}).update(done)
            said = f"{time.monotonic() - start:6.0f} s  {' '.join(jobs[job])}: {len(done)} episodes"
            console.print(said, markup=False, highlight=False)
    rows = [
        _figures(task, pack, quality, [found[task, pack][seed, is_careful(seed, quality)] for seed in seeds])
        for task, pack, quality in cells
    ]
    show(rows, seeds)
    if asked.json:
        told = [asdict(row) for row in rows]
        asked.json.write_text(json.dumps({"seeds": seeds, "cells": told}, indent=2) + "\n")


def _figures(task: str, pack: str, quality: float, episodes: Sequence[Episode]) -> Figures:
    return Figures(
        task,
        Path(pack).name,
        quality,
        len(episodes),
        sum(e.success for e in episodes),
        sum(e.success and e.elegant for e in episodes),
        fmean(e.steps for e in episodes),
        fmean(e.seconds for e in episodes),
        fmean(e.step_seconds for e in episodes),
    )


def show(rows: Sequence[Figures], seeds: Sequence[int]) -> None:
    """The table: one row a cell."""
    table = Table(
        title=f"Demonstrations, N = {len(seeds)} a cell, seeds {seeds[0]} to {seeds[-1]}", title_justify="left"
    )
    for name in ("task", "pack"):
        table.add_column(name)
    for name in ("quality", "success", "elegant of these", "steps", "s an episode", "of control steps"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*_cells(row), end_section=row is rows[-1] or rows[rows.index(row) + 1].task != row.task)
    Console(width=110).print(table)


def _cells(row: Figures) -> tuple[str, ...]:
    elegant = f"{row.elegant / row.success:.0%} ({row.elegant})" if row.success else "-"
    success = f"{row.success / row.episodes:.0%} ({row.success})"
    ratio = f"{row.seconds / row.step_seconds:.2f}x"
    return row.task, row.assets, f"{row.quality:g}", success, elegant, f"{row.steps:.0f}", f"{row.seconds:.2f}", ratio


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Success, elegance and cost of scripted demonstrations.")
    parser.add_argument("--task", action="append", help="a task; may be repeated (default: elegant/T0 to T7)")
    parser.add_argument("--episodes", type=int, default=50, help="a cell (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=SEED, help="the first (default: %(default)s)")
    parser.add_argument("--quality", type=float, nargs="+", default=[1.0, 0.5, 0.0], help="of the first pack's cells")
    parser.add_argument(
        "--assets", action="append", help="a pack; the first at every quality, the others at 0.5 (default: primitive)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here as well")
    return parser.parse_args()


if __name__ == "__main__":
    main()
