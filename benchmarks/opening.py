"""Opening a recording of 60 s until its bytes are served, against `rerun mcap convert` of the same file."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from statistics import median

from bench import Bench, interleaved
from machine import command
from recordings import recording
from report import Line, timed
from server import Server

NAME = "opening"
LIMIT = 1.5
REPETITIONS = 9


def measure(bench: Bench) -> Iterator[Line]:
    path = recording(bench, bench.count(60, 10))
    times = bench.count(REPETITIONS, 2)
    with bench.folder() as folder:
        convert = _convert(path, folder / "converted.rrd")
        # One name a repetition for the same bytes: an episode that is open already would open in no time.
        copies = folder / "copies"
        copies.mkdir()
        for number in range(times + 1):
            os.link(path, copies / f"episode_{number:02}.mcap")
        found: dict[str, tuple[list[float], list[float]]] = {"warm": ([], []), "cold": ([], [])}
        starts: list[float] = []
        homes = count()

        def cold() -> float:
            with Server(folder / f"home-{next(homes)}", "annotate", str(path), "--labels", str(folder / "l")) as server:
                starts.append(server.start_s)
                return _open(server, path.stem, server.started_at, found["cold"])

        with Server(folder / "warm", "annotate", str(copies), "--labels", str(folder / "labels")) as server:
            episodes = count()

            def warm() -> float:
                return _open(server, f"episode_{next(episodes):02}", time.perf_counter(), found["warm"])

            for action in (convert, warm):
                action()
            for side in found["warm"]:
                side.clear()
            with bench.progress("Opening") as say:
                done = count(1)

                def told(action: Callable[[], float]) -> Callable[[], float]:
                    def run() -> float:
                        say((next(done) - 1) / (3 * times), "")
                        return action()

                    return run

                peers = interleaved(times, convert=told(convert), warm=told(warm), cold=told(cold))["convert"]
    peer = median(peers)
    megabytes = f"{path.stat().st_size / 1e6:.0f} MB"
    yield timed(NAME, f"peer: rerun mcap convert, {megabytes}", peers)
    against = {"limit": LIMIT, "peer": peer}
    first, every = found["warm"]
    yield timed(NAME, "server running: until the first bytes", first, **against)
    yield timed(NAME, "server running: until all bytes", every, **against)
    yield timed(NAME, "from nothing: until the address is printed", starts)
    first, every = found["cold"]
    yield timed(NAME, "from nothing: until the first bytes", first, **against, note="Python and its imports included")
    yield timed(NAME, "from nothing: until all bytes", every, **against)


def _convert(path: Path, out: Path) -> Callable[[], float]:
    environment = os.environ | {"RERUN_ANALYTICS_ENABLED": "false"}
    arguments = [command("rerun"), "mcap", "convert", str(path), "-o", str(out)]

    def run() -> float:
        out.unlink(missing_ok=True)
        start = time.perf_counter()
        subprocess.run(arguments, env=environment, check=True, capture_output=True)
        return time.perf_counter() - start

    return run


def _open(server: Server, episode_id: str, start: float, found: tuple[list[float], list[float]]) -> float:
    """What the page does: the episode, then its recording. Adds seconds from `start` to first and to all bytes."""
    server.get(f"/api/episodes/{episode_id}")
    pieces = server.stream(f"/api/episodes/{episode_id}/recording.rrd")
    next(pieces)
    found[0].append(time.perf_counter() - start)
    for _ in pieces:
        pass
    found[1].append(time.perf_counter() - start)
    return found[1][-1]
