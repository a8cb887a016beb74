"""Rollouts told to a person as tables, and to a script as JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jiti.runtime.rollout.result import Rollout, without_nan
from jiti.runtime.rollout.summary import MethodSummary, Pairing, Rate, compare_all, summarize

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Report:
    """What a run of `jiti rollout` has to say."""

    folder: Path
    task: str
    rollouts: Sequence[Rollout]
    taken: dict[str, Any]
    """Policy, critic, seeds, tau: as they were given or found."""

    @property
    def methods(self) -> list[MethodSummary]:
        return summarize(self.rollouts)

    @property
    def pairings(self) -> list[Pairing]:
        """By ESR."""
        return compare_all(self.rollouts)

    def to_json(self) -> str:
        content = {
            "folder": str(self.folder),
            "task": self.task,
            **self.taken,
            "methods": [_method_json(method) for method in self.methods],
            "pairings": [asdict(pairing) for pairing in self.pairings],
            "success_pairings": [asdict(pairing) for pairing in compare_all(self.rollouts, "success")],
        }
        return json.dumps(without_nan(content), indent=2, allow_nan=False)

    def print(self, console: "Console | None" = None) -> None:
        """Tables on standard output, as wide as they must be where that is no terminal."""
        from rich.console import Console
        from rich.table import Table

        console = console or Console()
        if not console.is_terminal:
            console = Console(width=max(140, console.width), file=console.file)
        episodes = len(self.rollouts) // max(1, len(self.methods))
        table = Table(title=f"{self.task}: {episodes} episodes each, 95% intervals by Wilson", title_justify="left")
        for name in ("guidance", "success", "elegant (ESR)", "interventions", "of decisions", "ms a step", "cut off"):
            table.add_column(name, justify="left" if name == "guidance" else "right")
        for m in self.methods:
            table.add_row(
                m.label,
                rate_text(m.success),
                rate_text(m.elegant),
                f"{m.interventions:.2f} an episode",
                f"{m.triggered.value:.1%}" if m.triggered.of else "-",
                f"{m.step_ms:.1f} (sim {m.sim_ms:.1f})",
                str(m.cut_off),
            )
        console.print(table)
        if pairings := self.pairings:
            pairs = Table(title="ESR on the same initial states; exact McNemar, paired bootstrap", title_justify="left")
            for name in ("pair", "difference", "only the first", "only the second", "p"):
                pairs.add_column(name, justify="left" if name == "pair" else "right")
            for pair in pairings:
                low, high = pair.interval
                pairs.add_row(
                    f"{pair.first}, {pair.second}",
                    f"{100 * pair.difference:+.0f} ({100 * low:+.0f} to {100 * high:+.0f}) points",
                    str(pair.only_first),
                    str(pair.only_second),
                    f"{pair.p:.3g}",
                )
            console.print(pairs)
        for m in self.methods:
            if m.problems:
                console.print(
                    f"{m.label}: at {m.problems} of {m.triggered.of} decisions the critic gave no number, and the "
                    "default was executed; decisions.parquet has them."
                )


def rate_text(rate: Rate) -> str:
    """`0.62 (0.48 to 0.74)`"""
    low, high = rate.interval
    return f"{rate.value:.2f} ({low:.2f} to {high:.2f})"


def _method_json(method: MethodSummary) -> dict[str, Any]:
    rates = {
        name: {"rate": rate.value, "count": rate.count, "of": rate.of, "interval": rate.interval}
        for name in ("success", "elegant", "triggered", "changed")
        for rate in [getattr(method, name)]
    }
    return {**asdict(method), **rates}
