"""The first picture in a browser: real Chromium, from opening the printed address until both cameras are drawn."""

import io
import time
from collections.abc import Iterator
from contextlib import closing
from itertools import count

import av
import numpy as np
from bench import Bench
from machine import chromium
from playwright.sync_api import Browser, sync_playwright
from recordings import CAMERAS, recording
from report import Line, timed
from server import Server

NAME = "first picture"
REPETITIONS = 5
PATIENCE_S = 120.0
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
"""Drawn in software, so that it is the same on machines with and without a graphics card."""


def measure(bench: Bench) -> Iterator[Line]:
    path = recording(bench, bench.count(60, 10))
    times = bench.count(REPETITIONS, 1)
    executable = chromium()
    if executable is None:
        raise RuntimeError("no Chromium: run `apt-get install chromium`")
    running, nothing, again = [], [], []
    homes = count()
    with bench.folder() as folder, sync_playwright() as playwright, bench.progress("First picture") as say:
        browser = playwright.chromium.launch(executable_path=executable, args=FLAGS)
        for number in range(times):
            say(number / times, "")
            arguments = ("annotate", str(path), "--labels", str(folder / "labels"))
            with Server(folder / f"home-{next(homes)}", *arguments) as server:
                nothing.append(_until_drawn(browser, server.url, server.started_at))
                running.append(_until_drawn(browser, server.url, time.perf_counter()))
            with Server(folder / f"home-{next(homes)}", *arguments) as server:
                time.sleep(3)
                again.append(_until_drawn(browser, server.url, time.perf_counter()))
        browser.close()
    drawn = (
        "Chromium runs already, a new profile each time, drawing in software (SwiftShader) on the cores below; "
        "of its own work, a part counts as that of others"
    )
    yield timed(NAME, "server and recording open: page to picture", running, note=drawn)
    yield timed(NAME, "server up for 3 s: page to picture", again)
    yield timed(NAME, "from nothing: `jiti annotate` to picture", nothing)


def _until_drawn(browser: Browser, url: str, start: float) -> float:
    """Seconds from `start` until a page at `url` shows every camera. The viewer's program is fetched anew."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    try:
        page = context.new_page()
        page.goto(url)
        viewer = page.locator("#viewer")
        while _borders(viewer.screenshot(timeout=PATIENCE_S * 1000)) < len(CAMERAS):
            if time.perf_counter() - start > PATIENCE_S:
                raise RuntimeError(f"{url} showed no pictures in {PATIENCE_S:.0f} s")
            time.sleep(0.05)
        return time.perf_counter() - start
    finally:
        context.close()


def _borders(png: bytes) -> int:
    """Pictures side by side in a screenshot, found by the colour of their borders."""
    with closing(av.open(io.BytesIO(png), "r", format="png_pipe")) as container:
        pixels = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    r, g, b = (pixels[..., k] for k in range(3))
    columns = np.flatnonzero(((r > 180) & (b > 180) & (g < 90)).sum(0) > 4)
    runs = np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1)
    return sum(len(run) > 40 for run in runs)
