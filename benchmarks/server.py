"""`jiti` as a server in a process of its own, a client of it, and the memory that it took."""

import http.client
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

PATIENCE_S = 120.0
PIECE_BYTES = 1 << 18


class Server:
    """Runs `jiti ARGUMENTS --no-browser` with caches and settings under `home`. Ends with its `with` block."""

    def __init__(self, home: Path, *arguments: str) -> None:
        # As users have it: without compiled files each start would compile hundreds of modules anew.
        inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment = inherited | {
            "XDG_CACHE_HOME": str(home / "cache"),
            "XDG_CONFIG_HOME": str(home / "config"),
            "RERUN_ANALYTICS_ENABLED": "false",
        }
        home.mkdir(parents=True, exist_ok=True)
        self.log = home / "server.log"
        self.started_at = time.perf_counter()
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "jiti", *arguments, "--no-browser"],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        self.url = self._address()
        self.start_s = time.perf_counter() - self.started_at
        """From the start of the process until its address is printed."""
        parts = urlsplit(self.url)
        self._host, self._token = parts.netloc, parse_qs(parts.query)["token"][0]

    def _address(self) -> str:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("Open "):
                return line.split()[1]
        raise RuntimeError(f"jiti did not start: {self.log.read_text()}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout:
            self._process.stdout.close()

    @property
    def peak_bytes(self) -> int:
        """The largest resident memory that the process has had, shared and file-backed pages included."""
        for line in Path(f"/proc/{self._process.pid}/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
        raise RuntimeError("/proc does not tell the peak memory; this benchmark needs Linux")

    def get(self, path: str) -> Any:
        """The JSON answer to a GET."""
        return json.loads(self._answer("GET", path).read())

    def post(self, path: str, body: dict[str, Any]) -> bytes:
        """The answer to a POST, not parsed: that would be the client's time."""
        return self._answer("POST", path, json.dumps(body)).read()

    def stream(self, path: str) -> Iterator[bytes]:
        """The bytes of an answer as they come."""
        answer = self._answer("GET", path)
        while piece := answer.read1(PIECE_BYTES):
            yield piece

    def _answer(self, method: str, path: str, body: str | None = None) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection(self._host, timeout=PATIENCE_S)
        connection.request(method, path, body, {"Authorization": f"Bearer {self._token}"})
        answer = connection.getresponse()
        if answer.status != 200:
            raise RuntimeError(f"{method} {path}: {answer.status} {answer.read().decode(errors='replace')}")
        return answer
