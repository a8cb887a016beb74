"""Measures the annotator and the validation viewer: `uv run python benchmarks/annotate.py [--only NAME] [--quick]`.

Every figure is printed with its target; nothing fails by a figure. See the README beside this file.
"""

import argparse
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import command_line
import first_picture
import long_recording
import opening
import rewards
import saving
from bench import Bench
from machine import busy_percent, describe
from report import Line, figure, show
from rich.console import Console

BENCHMARKS = {module.NAME: module for module in (opening, first_picture, saving, rewards, command_line, long_recording)}


def main() -> None:
    asked = _arguments()
    console = Console(stderr=True)
    kept = asked.folder.resolve()
    kept.mkdir(parents=True, exist_ok=True)
    bench = Bench(kept, console, quick=asked.quick)
    machine = describe(kept)
    lines: list[Line] = []
    start = time.monotonic()
    for name in asked.only or BENCHMARKS:
        busy = busy_percent()
        console.print(f"{name} ({busy:.0f}% busy before)", markup=False, highlight=False)
        for line in BENCHMARKS[name].measure(bench):
            lines.append(replace(line, busy_percent=busy))
            console.print(
                f"  {line.what}: {figure(line.measured, line.unit)} {line.outcome}", markup=False, highlight=False
            )
    machine["took"] = f"{time.monotonic() - start:.0f} s"
    show(lines, machine, quick=asked.quick, console=Console(width=None if sys.stdout.isatty() else 170))
    if asked.json:
        answer = {"quick": asked.quick, "machine": machine, "lines": [line.to_json() for line in lines]}
        asked.json.write_text(json.dumps(answer, indent=2) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Measure the annotator and the validation viewer.")
    parser.add_argument("--only", action="append", choices=list(BENCHMARKS), help="one benchmark; may be repeated")
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it runs, measures nothing")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here as well")
    default = Path(tempfile.gettempdir()) / "jiti-benchmarks"
    parser.add_argument("--folder", type=Path, default=default, help="where recordings are kept (default: %(default)s)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
