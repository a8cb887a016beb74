"""What an evaluation says: success and ESR of each guidance, with their intervals, and pairs on the same layouts."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from jiti.errors import SourceError, UsageError
from jiti.runtime.robot.evaluation.judged import FILE, Judged, Kept, read_kept
from jiti.runtime.rollout.report import rate_text
from jiti.runtime.rollout.summary import Pairing, Rate, compare_all


@dataclass(frozen=True)
class EvaluationReport:
    """Of one folder."""

    kept: Kept
    blind: bool

    @property
    def task(self) -> str:
        return self.kept.settings["task"]

    @property
    def judged(self) -> list[Judged]:
        return [row for row in self.kept.rows if row.success is not None]

    @property
    def told(self) -> bool:
        """Whether figures of a guidance may be told: before all is judged they would tell which is which."""
        return not self.blind or self.kept.whole

    @property
    def pairings(self) -> list[Pairing]:
        """By ESR; none before two guidances have been judged on one layout."""
        try:
            return compare_all(self.judged)
        except UsageError:
            return []

    def to_dict(self) -> dict[str, Any]:
        content: dict[str, Any] = {"task": self.task, "planned": self.kept.planned, "judged": len(self.judged)}
        if not self.told:
            return content
        content["methods"] = [
            {"guidance": label}
            | {name: _told(rate) for name, rate in rates_of(own).items()}
            | {"itcs": {itc: _told(rate) for itc, rate in _itcs(own).items()}}
            for label, own in by_guidance(self.judged).items()
        ]
        content["pairings"] = [asdict(pair) for pair in self.pairings]
        return content

    def print(self) -> None:
        """Tables on standard output; of the tasks in the folders beside this one too."""
        from rich.console import Console
        from rich.table import Table

        console = Console()
        if not console.is_terminal:
            console = Console(width=max(140, console.width))
        if not self.told:
            console.print(
                f"{len(self.judged)} of {self.kept.planned} episodes are judged; which guidance did what is told when "
                f"all are. The same command goes on. {self.kept.path.parent}"
            )
            return
        table = Table(title="Judged by a person, 95% intervals by Wilson", title_justify="left")
        for name in ("task", "guidance", "episodes", "success", "elegant (ESR)"):
            table.add_column(name, justify="left" if name in ("task", "guidance") else "right")
        for task, rows in [(self.task, self.judged), *_beside(self.kept.path.parent)]:
            for label, own in by_guidance(rows).items():
                table.add_row(task, label, str(len(own)), *map(rate_text, rates_of(own).values()))
        console.print(table)
        for pair in self.pairings:
            low, high = pair.interval
            console.print(
                f"ESR, {pair.first} to {pair.second} on {pair.pairs} layouts: {100 * pair.difference:+.0f} points "
                f"({100 * low:+.0f} to {100 * high:+.0f}), p {pair.p:.3g} (exact McNemar)"
            )
        for label, own in by_guidance(self.judged).items():
            for itc, rate in _itcs(own).items():
                console.print(f"{label}: {itc} satisfied {rate_text(rate)} of {rate.of}")


def by_guidance(rows: Sequence[Judged]) -> dict[str, list[Judged]]:
    """By name."""
    return {label: [row for row in rows if row.guidance == label] for label in sorted({row.guidance for row in rows})}


def rates_of(rows: Sequence[Judged]) -> dict[str, Rate]:
    """Success, and ESR."""
    count = len(rows)
    return {
        "success": Rate(sum(bool(r.success) for r in rows), count),
        "elegant": Rate(sum(r.elegant for r in rows), count),
    }


def _itcs(rows: Sequence[Judged]) -> dict[str, Rate]:
    """Of those of which the person could tell."""
    known: dict[str, list[bool]] = {}
    for row in rows:
        for itc, verdict in row.itcs.items():
            if verdict is not None:
                known.setdefault(itc, []).append(verdict)
    return {itc: Rate(sum(verdicts), len(verdicts)) for itc, verdicts in known.items()}


def _beside(folder: Path) -> list[tuple[str, Sequence[Judged]]]:
    """Evaluations that are judged whole in the folders beside one: of what, with the folder's name, and how."""
    found: list[tuple[str, Sequence[Judged]]] = []
    for path in sorted(folder.parent.glob(f"*/{FILE}")):
        if path.parent.resolve() == folder.resolve():
            continue
        with suppress(SourceError):  # which is told when it is gone on with
            kept = read_kept(path)
            if kept.whole:
                found.append((f"{kept.settings['task']} ({path.parent.name})", kept.rows))
    return found


def _told(rate: Rate) -> dict[str, Any]:
    return {"rate": rate.value, "count": rate.count, "of": rate.of, "interval": rate.interval}
