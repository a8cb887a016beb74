"""How well critics rank elegant over inelegant on demonstrations that they never saw, and on labels that say nothing.

    uv run python benchmarks/ranking.py DATASET HELD_OUT --seeds 0 1 2 --json figures.json

Both are datasets of `jiti curate`, recorded with different seeds. A critic is trained on the train split of DATASET,
kept where it ranks its validation split best, and evaluated on all of HELD_OUT: AUC of Q of the recorded chunks at the
decided segment (`jiti.critic.ranking`), for each task. The control is the same with the verdicts of DATASET dealt anew
within each task; it must come out near 0.5. Runs are kept in --folder, and go on there.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

from rich.console import Console
from rich.table import Table

WANTED = 0.85
"""Average AUC that is to be reached."""


def rank_all(asked: argparse.Namespace, console: Console) -> list[dict[str, Any]]:
    """A row for each seed, with labels as they are and dealt anew."""
    from jiti.critic.evaluate import evaluate
    from jiti.critic.settings_file import read_settings
    from jiti.critic.train import train

    settings = read_settings(asked.config)
    rows = []
    for shuffled in (False, True):
        for seed in asked.seeds:
            run = asked.folder / f"{'shuffled' if shuffled else 'labels'}-{seed}"
            console.print(f"{run.name} ...")
            chosen = replace(
                settings,
                data=replace(settings.data, shuffle_labels=shuffled),
                run=replace(settings.run, seed=seed, steps=asked.steps or settings.run.steps),
            )
            cache = asked.folder / "features"
            trained = train(asked.dataset, run, chosen, features_dir=cache)
            found = evaluate(run, asked.held_out, split="all", features_dir=cache)
            decided = found.rankings[0]
            rows.append(
                {
                    "labels": "dealt anew" if shuffled else "as they are",
                    "seed": seed,
                    "kept_step": trained.best.get("step"),
                    "validation": trained.best.get("auc"),
                    "auc": decided.auc,
                    "counts": decided.counts,
                    "average": decided.average,
                    "earlier": {str(lead): ranking.average for lead, ranking in found.rankings.items()},
                    "chunks_of_others": found.swapped.average,
                }
            )
    return rows


def table_of(rows: list[dict[str, Any]]) -> Table:
    """A column for each run."""
    title = f"AUC on {sum(sum(pair) for pair in rows[0]['counts'].values())} held-out demonstrations"
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for row in rows:
        table.add_column(
            f"seed {row['seed']}" + (", dealt anew" if row["labels"] != "as they are" else ""), justify="right"
        )

    def add(name: str, figures: list[float | None]) -> None:
        table.add_row(name, *("-" if figure is None else f"{figure:.2f}" for figure in figures))

    for task in sorted({task for row in rows for task in row["auc"]}):
        good, bad = rows[0]["counts"][task]
        add(f"{task} ({good} + {bad})", [row["auc"].get(task) for row in rows])
    add("average", [row["average"] for row in rows])
    for lead in list(rows[0]["earlier"])[1:]:
        add(f"{lead} frames earlier", [row["earlier"][lead] for row in rows])
    add("chunks of another episode", [row["chunks_of_others"] for row in rows])
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="DATASET")
    parser.add_argument("held_out", type=Path, metavar="HELD_OUT")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--config", type=Path, default=Path("state"), help="as of `jiti train-critic` (default: state)")
    parser.add_argument("--steps", type=int, help="other than the configuration's")
    parser.add_argument("--folder", type=Path, help="keeps runs and features (default: a temporary folder)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here as well")
    asked = parser.parse_args()
    asked.folder = asked.folder or Path(tempfile.mkdtemp(prefix="jiti-ranking-"))
    console = Console()
    rows = rank_all(asked, console)
    console.print(table_of(rows))
    for labels in ("as they are", "dealt anew"):
        mean = fmean(row["average"] for row in rows if row["labels"] == labels)
        console.print(f"Labels {labels}: {mean:.3f} on average of {len(asked.seeds)} seeds.", highlight=False)
    reached = fmean(row["average"] for row in rows if row["labels"] == "as they are") >= WANTED
    console.print(f"Wanted: {WANTED}: {'pass' if reached else 'FAIL'}.", highlight=False)
    console.print(f"Runs: {asked.folder}", highlight=False)
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
