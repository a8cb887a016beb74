"""How often scripted demonstrations succeed and are elegant, and what one costs: a table over tasks, packs, qualities.

    uv run python benchmarks/demonstrations.py --episodes 50 --assets primitive --assets ../shared/libero-assets

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
from pathlib import Path

from rich.console import Console
from rich.table import Table

ELEGANT = tuple(f"elegant/T{k}" for k in range(8))
SEED = 1000
"""First seed. Experts were written with seeds below 200."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One task with one pack at one quality."""

    task: str
    assets: str
    quality: float
    seeds: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Figures:
    """What came out of a cell."""

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


def measure(cell: Cell) -> Figures:
    """Demonstrate with every seed of a cell."""
    import numpy as np

    from jiti.runtime.sim.demonstrators import demonstrator_for
    from jiti.runtime.sim.episode import run_episode
    from jiti.runtime.sim.monitor import Monitor
    from jiti.runtime.sim.scene import Scene
    from jiti.tasks.catalogue import load_catalogue

    outcomes, taken, stepping = [], [], []
    with Scene(load_catalogue().simulated(cell.task), assets=cell.assets) as scene:
        for seed in cell.seeds:
            begin, spent = time.perf_counter(), [0.0]

            def step(action: np.ndarray, spent: list[float] = spent) -> None:
                before = time.perf_counter()
                scene.step(action)
                spent[0] += time.perf_counter() - before

            scene.reset(seed)
            actor = demonstrator_for(scene, seed, cell.quality)
            outcomes.append(run_episode(Monitor(scene), actor, step))
            taken.append(time.perf_counter() - begin)
            stepping.append(spent[0])
    return Figures(
        cell.task,
        Path(cell.assets).name,
        cell.quality,
        len(outcomes),
        sum(o.success for o in outcomes),
        sum(o.elegant for o in outcomes),
        float(np.mean([o.steps for o in outcomes])),
        float(np.mean(taken)),
        float(np.mean(stepping)),
    )


def main() -> None:
    asked = _arguments()
    console = Console(stderr=True)
    seeds = tuple(range(asked.seed, asked.seed + asked.episodes))
    packs = asked.assets or ["primitive"]
    cells = [Cell(task, packs[0], quality, seeds) for task in asked.task or ELEGANT for quality in asked.quality]
    cells += [Cell(task, pack, 0.5, seeds) for task in asked.task or ELEGANT for pack in packs[1:]]
    found: dict[Cell, Figures] = {}
    context = multiprocessing.get_context("spawn")
    start = time.monotonic()
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=context, max_tasks_per_child=1) as pool:
        jobs = {pool.submit(measure, cell): cell for cell in cells}
        for job in as_completed(jobs):
            figures = found[jobs[job]] = job.result()
            console.print(f"{time.monotonic() - start:6.0f} s  {_line(figures)}", markup=False, highlight=False)
    rows = [found[cell] for cell in cells]
    show(rows, seeds)
    if asked.json:
        told = [asdict(row) for row in rows]
        asked.json.write_text(json.dumps({"seeds": seeds, "cells": told}, indent=2) + "\n")


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


def _line(row: Figures) -> str:
    return "  ".join(_cells(row))


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
