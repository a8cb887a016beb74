"""What a benchmark found: one figure a line, its target, and whether it meets it; as a table and as JSON."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True, slots=True)
class Line:
    """One measured figure. Lower is better wherever there is a limit."""

    benchmark: str
    what: str
    measured: float
    unit: str
    count: int
    """Repetitions that the figure is the median (or another share, then said in `what`) of."""
    limit: float | None = None
    """The largest figure that passes, in `unit`; with a peer, the largest multiple of it."""
    peer: float | None = None
    """What the peer took, in `unit`."""
    least: float | None = None
    most: float | None = None
    note: str = ""
    others_percent: float | None = None
    """Share of all cores that other work took during the benchmark; the more, the less the figure says."""

    @property
    def ratio(self) -> float | None:
        """To the peer where there is one, else to the limit."""
        of = self.peer or self.limit
        return self.measured / of if of else None

    @property
    def outcome(self) -> str:
        if self.limit is None:
            return "-"
        bound = self.limit * self.peer if self.peer else self.limit
        return "pass" if self.measured <= bound else "FAIL"

    def to_json(self) -> dict[str, Any]:
        return asdict(self) | {"ratio": self.ratio, "outcome": self.outcome}


def timed(benchmark: str, what: str, times_s: Sequence[float], **more: Any) -> Line:
    """A line with the median of some times."""
    return Line(benchmark, what, median(times_s), "s", len(times_s), least=min(times_s), most=max(times_s), **more)


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest value that at least `share` of all do not exceed."""
    return sorted(values)[max(0, -int(-share * len(values) // 1) - 1)]


def figure(value: float | None, unit: str) -> str:
    """Three digits and a unit that reads well."""
    if value is None:
        return ""
    if unit == "s" and value < 1:
        value, unit = value * 1000, "ms"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f} {unit}"


def show(lines: Sequence[Line], machine: dict[str, str], *, quick: bool, console: Console) -> None:
    """The table, then the machine on which it was measured."""
    title = "jiti annotate" + (" (QUICK: smaller than the real size, not to be compared)" if quick else "")
    table = Table(title=title, title_justify="left", show_lines=False)
    for name in ("benchmark", "what"):
        table.add_column(name)
    for name in ("target", "measured", "least - most", "ratio", "N", "others"):
        table.add_column(name, justify="right")
    table.add_column("outcome")
    last = ""
    for line in lines:
        if line.benchmark != last and last:
            table.add_section()
        table.add_row(line.benchmark if line.benchmark != last else "", *_cells(line))
        last = line.benchmark
    console.print(table)
    for line in lines:
        if line.note:
            console.print(f"  {line.benchmark}, {line.what}: {line.note}.", markup=False, highlight=False)
    console.print(
        "Ratio: to the peer where the target is a multiple of it, else to the target. Others: share of all cores"
    )
    console.print("that work which is not the benchmark's took meanwhile. All files are in the page cache.")
    for name, value in machine.items():
        console.print(f"  {name}: {value}", markup=False, highlight=False)


def _cells(line: Line) -> Iterator[str]:
    yield line.what
    if line.limit is None:
        yield ""
    else:
        yield f"{line.limit:g}x {figure(line.peer, line.unit)}" if line.peer else figure(line.limit, line.unit)
    yield figure(line.measured, line.unit)
    spread = line.least is not None and line.most is not None
    yield f"{figure(line.least, line.unit)} - {figure(line.most, line.unit)}" if spread else ""
    yield "" if line.ratio is None else f"{line.ratio:.2f}x"
    yield str(line.count)
    yield "" if line.others_percent is None else f"{line.others_percent:.0f}%"
    yield {"pass": "[green]pass[/]", "FAIL": "[bold red]FAIL[/]"}.get(line.outcome, line.outcome)
