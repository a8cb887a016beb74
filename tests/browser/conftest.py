"""Real Chromium against the real command line: a server in a process of its own, a page driven by keys."""

import io
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from tests.builders.pictures import find_pictures, read_number

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
PATIENCE_S = 90.0
"""For a page on two busy cores that draw in software."""


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of Chromium. Without one: a failure where CI=true, else a skip."""
    for name in ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"):
        if path := shutil.which(name):
            return path
    reason = "no Chromium: run `apt-get install chromium`"
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def browser(chromium: str) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield browser
        browser.close()


@dataclass
class Server:
    """`jiti ARGS --no-browser` in a process, and the address that it printed."""

    args: list[str]
    folder: Path
    process: subprocess.Popen[str] = field(init=False)
    url: str = field(init=False)

    def __post_init__(self) -> None:
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "jiti", *self.args, "--no-browser"],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self.process.stdout is not None
        lines = []
        for line in self.process.stdout:
            lines.append(line)
            if line.startswith("Open "):
                self.url = line.split()[1]
                return
        self.process.wait()
        self._close()
        raise AssertionError(f"jiti {self.args} did not start: {''.join(lines)}")

    def kill(self) -> None:
        """kill -9: nothing gets a chance to clean up."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self._close()

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(timeout=20)
        self._close()

    def _close(self) -> None:
        if self.process.stdout:
            self.process.stdout.close()


@pytest.fixture
def serve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Server]]:
    """Start `jiti ARGS`; all servers end with the test. Caches and settings are the test's own."""
    for variable, folder in (("XDG_CACHE_HOME", "cache"), ("XDG_CONFIG_HOME", "config")):
        monkeypatch.setenv(variable, str(tmp_path / f".{folder}"))
    servers: list[Server] = []

    def start(*args: str, folder: Path = tmp_path) -> Server:
        servers.append(Server(list(args), folder))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()


class Screen:
    """A page of ours, what it says of its state, and the numbers in the pictures that it shows."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.errors: list[str] = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    def open(self, url: str) -> "Screen":
        self.page.goto(url)
        return self.painted()

    def reload(self) -> "Screen":
        self.page.reload()
        return self.painted()

    def painted(self) -> "Screen":
        """Wait for the first paint: Chromium drops keys that come before it, as no one could have meant them."""
        paint = "performance.getEntriesByName('first-contentful-paint').length"
        self.until(lambda: self.page.evaluate(paint), lambda: "the first paint")
        return self

    @property
    def state(self) -> dict[str, str]:
        return self.page.evaluate("({...document.getElementById('state').dataset})")

    def press(self, *keys: str) -> "Screen":
        """Press real keys, one after another."""
        for key in keys:
            self.page.keyboard.press(key)
        return self

    def wait(self, **wanted: Any) -> "Screen":
        """Wait until the page's state is as wanted."""
        texts = {name: str(value) for name, value in wanted.items()}
        self.until(lambda: all(self.state.get(k) == v for k, v in texts.items()), lambda: f"{texts}, is {self.state}")
        return self

    def until(self, done: Callable[[], Any], say: Callable[[], str] = lambda: "a condition") -> Any:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            if result := done():
                return result
            time.sleep(0.05)
        raise AssertionError(f"waited {PATIENCE_S} s for {say()}; page errors: {self.errors}")

    def ready(self) -> "Screen":
        """Wait until the viewer has the recording."""
        self.until(lambda: self.page.evaluate("document.body.dataset.recording"), lambda: "the recording")
        return self

    def picture(self) -> np.ndarray:
        """What the viewer shows, (height, width, 3) uint8."""
        return png_pixels(self.page.locator("#viewer").screenshot(timeout=PATIENCE_S * 1000))

    def numbers(self) -> list[int]:
        """Frame numbers in the pictures shown, left to right."""
        return [read_number(found) for found in find_pictures(self.picture())]

    def wait_numbers(self, wanted: list[int]) -> None:
        """Wait until the pictures show these numbers, and still do a moment later."""
        seen: list[list[int]] = []

        def steady() -> bool:
            seen.append(self.numbers())
            return len(seen) > 1 and seen[-1] == seen[-2] == wanted

        self.until(steady, lambda: f"pictures {wanted}, shown were {seen[-5:]}")


@pytest.fixture
def screen(browser: Browser) -> Iterator[Callable[..., Screen]]:
    """Open a page in a context of its own: `screen(url)`, `screen(url, width=1920, scheme="dark")`."""
    contexts = []

    def show(url: str, *, width: int = 1280, height: int = 720, scheme: str = "light") -> Screen:
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)  # type: ignore[arg-type]
        contexts.append(context)
        return Screen(context.new_page()).open(url)

    yield show
    for context in contexts:
        context.close()


def png_pixels(png: bytes) -> np.ndarray:
    """A PNG as (height, width, 3) uint8."""
    with av.open(io.BytesIO(png), format="png_pipe") as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")
