"""Where a benchmark ran, and how busy that machine was."""

import os
import platform
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import psutil

PACKAGES = ("jiti", "rerun-sdk", "av", "pyarrow", "numpy", "mcap", "starlette", "uvicorn", "typer", "playwright")


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


def busy_percent(interval_s: float = 1.0) -> float:
    """Share of all cores that is in use while this process waits."""
    return psutil.cpu_percent(interval_s)


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
