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
from machine import OtherWork, describe, wait_for_calm
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
        wait_for_calm(asked.calm)
        console.print(name)
        with OtherWork() as others:
            found = list(BENCHMARKS[name].measure(bench))
        for line in found:
            said = f"  {line.what}: {figure(line.measured, line.unit)} {line.outcome}"
            console.print(said, markup=False, highlight=False)
        lines += [replace(line, others_percent=others.percent) for line in found]
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
    calm = "wait at most so long before each benchmark until others leave the machine alone (default: %(default)s)"
    parser.add_argument("--calm", type=float, default=0.0, metavar="SECONDS", help=calm)
    return parser.parse_args()


if __name__ == "__main__":
    main()
