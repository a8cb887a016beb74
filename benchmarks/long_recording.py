"""An hour with two cameras: memory of the server while it makes the lighter copy and streams it, and how fast."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

from bench import Bench
from recordings import CAMERAS, RATE_HZ, recording
from report import Line
from server import Server

NAME = "hour"
MEMORY_LIMIT_GB = 1.0
HOUR_S = 3600
QUICK_S = 180
ASK_EVERY_S = 1.0


class Client(threading.Thread):
    """Takes the recording as the page does, counts its bytes and keeps none."""

    def __init__(self, server: Server, episode_id: str) -> None:
        super().__init__(name="client")
        self.where = f"/api/episodes/{episode_id}"
        self._server = server
        self.opened_s = self.first_s = self.all_s = 0.0
        self.byte_count = 0
        self.error: Exception | None = None

    def run(self) -> None:
        start = time.perf_counter()
        try:
            self._server.get(self.where)
            self.opened_s = time.perf_counter() - start
            for piece in self._server.stream(f"{self.where}/recording.rrd"):
                self.first_s = self.first_s or time.perf_counter() - start
                self.byte_count += len(piece)
            self.all_s = time.perf_counter() - start
        except Exception as error:  # raised again by the thread that measures
            self.error = error


def measure(bench: Bench) -> Iterator[Line]:
    seconds = bench.count(HOUR_S, QUICK_S)
    path = recording(bench, seconds, large_pictures=bench.quick)
    with bench.folder() as folder:
        home = folder / "home"
        arguments = ("annotate", str(path), "--labels", str(folder / "labels"))
        with Server(home, *arguments) as server:
            client = Client(server, path.stem)
            client.start()
            _watch(bench, server, client)
            peak_gb = server.peak_bytes / 1e9
        copy_bytes = sum(file.stat().st_size for file in (home / "cache/jiti/proxies").glob("*.rrd"))
        with Server(home, *arguments) as server:
            again = Client(server, path.stem)
            again.start()
            again.join()
            again_gb = server.peak_bytes / 1e9
    for one in (client, again):
        if one.error:
            raise one.error
    if not copy_bytes or client.byte_count != copy_bytes:
        raise RuntimeError(f"{client.byte_count} bytes were streamed, the finished copy has {copy_bytes}")
    yield from _lines(path, seconds, client, again, copy_bytes, peak_gb, again_gb)


def _lines(
    path: Path, seconds: int, client: Client, again: Client, copy_bytes: int, peak_gb: float, again_gb: float
) -> Iterator[Line]:
    pictures = seconds * RATE_HZ * len(CAMERAS)
    size = path.stat().st_size
    building_s = client.all_s - client.opened_s
    about = f"{seconds} s, {pictures:,} pictures, {size / 1e9:.2f} GB; one client takes the copy while it is made"
    yield Line(NAME, "peak memory of the server, making the copy", peak_gb, "GB", 1, limit=MEMORY_LIMIT_GB, note=about)
    yield Line(NAME, "peak memory of the server, copy there", again_gb, "GB", 1, limit=MEMORY_LIMIT_GB)
    yield Line(NAME, "until the episode is open", client.opened_s, "s", 1)
    yield Line(NAME, "until the first bytes", client.first_s, "s", 1)
    yield Line(NAME, "until all bytes, the copy made", client.all_s, "s", 1)
    yield Line(NAME, "until all bytes, the copy there", again.all_s, "s", 1)
    yield Line(NAME, "pictures a second", pictures / building_s, "/s", 1)
    yield Line(NAME, "size of the copy", copy_bytes / 1e6, "MB", 1, note=f"{copy_bytes / size:.1%} of the recording")


def _watch(bench: Bench, server: Server, client: Client) -> None:
    """Show how far the copy is, as the page does, until the client has all of it."""
    with bench.progress("Making the lighter copy") as say:
        while client.is_alive():
            client.join(ASK_EVERY_S)
            if client.opened_s and client.is_alive():
                proxy = server.get(f"{client.where}/proxy")["proxy"]
                if proxy is None:
                    raise RuntimeError("the recording is small enough to be shown as it is")
                left = f"{proxy['seconds_left']:.0f} s left" if proxy["seconds_left"] is not None else ""
                say(proxy["frames_done"] / proxy["frame_count"], left)
