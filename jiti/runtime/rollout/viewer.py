"""Rerun's viewer as a process of its own: in a window where there is a display, else for a browser on this machine."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable

from jiti.errors import UsageError

LOCAL = "127.0.0.1"
"""Rerun itself would listen on every interface."""
PATIENCE_S = 30.0
"""In which it must listen. Our choice: it takes a second or two."""


class Viewer:
    """Listens at `address`. A window stays open when this process ends; what is served to a browser ends with it."""

    def __init__(self, say: Callable[[str], None]) -> None:
        """Raises UsageError when it does not start."""
        port, page = _free_port(), _free_port()
        self.address = f"rerun+http://{LOCAL}:{port}/proxy"
        self.in_window = sys.platform in ("darwin", "win32") or bool(
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        )
        line = [sys.executable, "-m", "rerun", "--bind", LOCAL, "--port", str(port), "--expect-data-soon"]
        if not self.in_window:
            line += ["--serve-web", "--web-viewer-port", str(page)]
        quiet = {**os.environ, "RERUN_ANALYTICS_ENABLED": "false", "RUST_LOG": "error"}
        self._process = subprocess.Popen(
            line,
            env=quiet,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=self.in_window,
        )
        self._say = say
        self._wait_for(port)
        if not self.in_window:
            self._wait_for(page)
            say(f"Open http://{LOCAL}:{page}?url={self.address.replace(':', '%3A').replace('/', '%2F')}")

    def wait(self) -> None:
        """Keep a page up until a person has looked; where no one is there to say so, do not wait."""
        if not self.in_window and sys.stdin.isatty() and self._process.poll() is None:
            self._say("All played. Press Enter to end the viewer.")
            sys.stdin.readline()

    def close(self) -> None:
        """End what is served to a browser."""
        if not self.in_window and self._process.poll() is None:
            self._process.terminate()
            self._process.wait()

    def _wait_for(self, port: int) -> None:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end and self._process.poll() is None:
            try:
                socket.create_connection((LOCAL, port), 1).close()
                return
            except OSError:
                time.sleep(0.1)
        self.close()
        raise UsageError(
            "Rerun's viewer did not start here. Leave --live out: `jiti annotate` on the folder of rollouts shows them."
        )


def _free_port() -> int:
    with socket.socket() as free:
        free.bind((LOCAL, 0))
        return free.getsockname()[1]
