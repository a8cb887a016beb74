"""A benchmark that is a program of its own: its arguments, its figures as a table and as JSON."""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from bench import Bench
from machine import OtherWork, describe
from report import Line, show
from rich.console import Console


def arguments(about: str | None) -> argparse.ArgumentParser:
    """Those that all of them take; `about` is the docstring of the program."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it runs, measures nothing")
    parser.add_argument("--folder", type=Path, help="keeps what is made once (default: a temporary folder)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here as well")
    return parser


def run(asked: argparse.Namespace, measure: Callable[[Bench], Iterable[Line]]) -> None:
    """Measure and show."""
    kept = asked.folder or Path(tempfile.gettempdir()) / "jiti-benchmarks"
    kept.mkdir(parents=True, exist_ok=True)
    bench = Bench(kept, Console(stderr=True), asked.quick)
    with OtherWork() as other:
        lines = list(measure(bench))
    lines = [replace(line, others_percent=other.percent) for line in lines]
    machine = describe(kept)
    show(lines, machine, quick=asked.quick, console=Console())
    if asked.json:
        asked.json.write_text(json.dumps({"machine": machine, "lines": [line.to_json() for line in lines]}, indent=2))
