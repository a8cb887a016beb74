"""What `jiti autolabel --vlm` costs beside the model: decoding, contact sheets, numbers, requests, files.

    uv run python benchmarks/autolabel.py --json figures.json

The model is a server of another process that answers at once, so all the time is ours and HTTP's. Episodes are 10 s of
two 640x480 JPEG cameras with four ITCs, each of which takes a request for segments and three for a verdict, with two
to four contact sheets in each. A request's share of a core is the processor time of our process for it; its inverse is
how many a second one core can feed to a model. The peer of a sheet is a pass over the same file with mcap alone.
"""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from bench import Bench
from mcap.reader import make_reader
from program import arguments, run
from recordings import episodes, recording
from report import Line, timed

from jiti.annotate.autolabel import autolabel
from jiti.annotate.engine import Engine
from jiti.annotate.events import find_events
from jiti.annotate.proposer import Proposer
from jiti.annotate.vlm.locate import overview
from jiti.annotate.vlm.settings import Settings
from jiti.episodes.reader import open_reader

ROOT = Path(__file__).parents[1]
SHEETS_S = 1.5
"""Limit for the contact sheets of a 60 s episode with two cameras."""
SERVER = (
    "import sys, threading; from tests.builders.scripted_server import scripted\n"
    "with scripted() as server:\n    print(server.url, flush=True); sys.stdin.read()"
)


def measure(bench: Bench) -> Iterator[Line]:
    yield from _sheets(bench)
    yield from _episodes(bench)


def _sheets(bench: Bench) -> Iterator[Line]:
    seconds = bench.count(60, 10)
    path = recording(bench, seconds)
    times, peers = [], []
    for _ in range(bench.count(9, 2)):
        peers.append(_pass_over(path))
        begin = time.perf_counter()
        reader = open_reader(path)
        episode = reader.open(reader.episodes()[0].episode_id)
        cameras = tuple(s.name for s in episode.streams.values() if s.kind == "camera")
        overview(episode, cameras, find_events(episode))
        times.append(time.perf_counter() - begin)
    yield timed("sheets", f"peer: one pass over {path.stat().st_size / 1e6:.0f} MB with mcap", peers)
    yield timed("sheets", f"contact sheets of {seconds} s, two cameras, from opening the file", times, limit=SHEETS_S)


def _episodes(bench: Bench) -> Iterator[Line]:
    count = bench.count(24, 3)
    source = episodes(bench, 10, count)
    engines: tuple[Engine, ...] = ("local", "ray")
    with bench.folder() as folder, _server() as url:
        for engine in engines:
            walls, shares, requests = [], [], 0
            for run in range(bench.count(3, 1)):
                labels = folder / f"labels-{engine}-{run}"
                settings = Settings("tiny", url, fuse=False)
                proposer = Proposer(str(source), labels, by="vlm", fuse=False, settings=settings)
                begin, cpu = time.perf_counter(), time.process_time()
                done = autolabel(open_reader(source), proposer, engine=engine)
                walls.append(time.perf_counter() - begin)
                if done.failures or done.skipped or done.episodes != count:
                    raise SystemExit(f"{engine}: {done}")
                requests = done.usage.requests
                shares.append((time.process_time() - cpu) / requests)
            yield timed("episodes", f"{engine}: {count} episodes, {requests} requests", walls)
            rates = [count / wall for wall in walls]
            yield Line(
                "episodes", f"{engine}: episodes", median(rates), "/s", len(rates), least=min(rates), most=max(rates)
            )
            if engine == "local":
                yield timed("episodes", "local: processor time a request", shares)
                fed = [1 / share for share in shares]
                yield Line(
                    "episodes", "local: requests that a core feeds", median(fed), "/s", 3, least=min(fed), most=max(fed)
                )


def _pass_over(path: Path) -> float:
    begin = time.perf_counter()
    with path.open("rb") as file:
        for _ in make_reader(file).iter_messages():
            pass
    return time.perf_counter() - begin


@contextmanager
def _server() -> Iterator[str]:
    """An instant model server in a process of its own."""
    command = [sys.executable, "-c", SERVER]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        yield process.stdout.readline().strip()
        process.communicate()


def main() -> None:
    run(arguments(__doc__).parse_args(), measure)


if __name__ == "__main__":
    main()
