"""Where a benchmark ran, and how busy that machine was."""

import os
import platform
import resource
import shutil
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil

PACKAGES = ("jiti", "rerun-sdk", "av", "pyarrow", "numpy", "mcap", "starlette", "uvicorn", "typer", "playwright")

CALM_PERCENT, CALM_S = 15.0, 5.0


def describe(folder: Path) -> dict[str, str]:
    """Cores, memory, disk under `folder`, and versions."""
    memory = psutil.virtual_memory()
    return {
        "machine": f"{_processor()}, {len(os.sched_getaffinity(0))} cores, {memory.total / 2**30:.0f} GiB of memory",
        "disk": _disk(folder),
        "system": f"{platform.system()} {platform.release()}, Python {platform.python_version()}",
        "packages": ", ".join(f"{name} {version(name)}" for name in PACKAGES),
        "browser": _said(chromium() or "chromium", "--version") or "none",
        "revision": _said("git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty") or "unknown",
    }


class OtherWork:
    """How much of the cores work that is not ours takes, from `with` to its end."""

    def __enter__(self) -> Self:
        self._start = _times_s()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        everything_s, ours_s, idle_s = (end - start for end, start in zip(_times_s(), self._start, strict=True))
        self.percent = 100 * max(0.0, everything_s - ours_s) / max(1e-9, everything_s + idle_s)


def _times_s() -> tuple[float, float, float]:
    """CPU seconds so far: of the whole machine, of this process and its ended children, and idle."""
    cpu = psutil.cpu_times()
    used_s = cpu.user + cpu.nice + cpu.system + cpu.irq + cpu.softirq + cpu.steal
    ours = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return used_s, sum(one.ru_utime + one.ru_stime for one in ours), cpu.idle + cpu.iowait


def wait_for_calm(patience_s: float) -> None:
    """Wait until other work takes less than `CALM_PERCENT` of all cores, but not for ever."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end and psutil.cpu_percent(CALM_S) > CALM_PERCENT:
        pass


def chromium() -> str | None:
    """Path of Chromium, or None."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    return next(filter(None, map(shutil.which, names)), None)


def command(name: str) -> str:
    """Path of a command of this Python's environment. Exits with a message when it is not there."""
    path = Path(sys.executable).parent / name
    if not path.exists():
        sys.exit(f"{path} is missing: run `uv sync` and start this with `uv run python benchmarks/annotate.py`.")
    return str(path)


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _disk(folder: Path) -> str:
    mounted = [p for p in psutil.disk_partitions(all=True) if folder.resolve().is_relative_to(p.mountpoint)]
    place = max(mounted, key=lambda p: len(p.mountpoint))
    return f"{folder} on {place.fstype} ({place.device}), {shutil.disk_usage(folder).free / 1e9:.0f} GB free"


def _said(*arguments: str) -> str:
    try:
        return subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
