"""The validation viewer over 10,000 episodes of 300 frames: first answer, later ones, suspects, memory."""

import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

from bench import Bench
from many_episodes import dataset
from report import Line, timed
from server import Server

NAME = "rewards"
FIRST_LIMIT_S = 2.0
MEMORY_LIMIT_GB = 1.0
REPETITIONS = 5
GAMMAS = (0.9, 0.95, 0.97, 0.99, 0.995)
PATIENCE_S = 300.0


def measure(bench: Bench) -> Iterator[Line]:
    episodes = bench.count(10_000, 500)
    root = dataset(bench, episodes)
    times = bench.count(REPETITIONS, 1)
    starts, first, warm, gammas = [], [], [], []
    suspects, complete, listing, listed, later, memory = [], [], [], [], [], []
    with bench.folder() as folder, bench.progress("Rewards") as say:
        for number in range(times):
            home = folder / f"home-{number}"
            step = count()

            def tell(what: str, number: int = number, step: Iterator[int] = step) -> None:
                say((number + next(step) / 6) / times, what)

            with Server(home, *_arguments(root)) as server:
                starts.append(server.start_s)
                tell("first answer")
                first.append(_seconds(lambda: server.get("/api/rewards?gamma=0.98")))
                memory.append(server.peak_bytes / 1e9)
                tell("the same again")
                warm += [_seconds(lambda: server.get("/api/rewards?gamma=0.98")) for _ in range(3)]
                gammas += [_seconds(lambda g=gamma: server.get(f"/api/rewards?gamma={g}")) for gamma in GAMMAS]
                tell("suspects")
                suspects.append(_seconds(lambda: server.get("/api/rewards/suspects?gamma=0.98")))
                complete.append(suspects[-1] + _seconds(lambda: _until_complete(server)))
                tell("list of episodes")
                listing.append(_seconds(lambda: server.get("/api/episodes")))
                listed += [_seconds(lambda: server.get("/api/episodes")) for _ in range(3)]
                memory[-1] = max(memory[-1], server.peak_bytes / 1e9)
            tell("started again")
            with Server(home, *_arguments(root)) as server:
                later.append(_seconds(lambda: server.get("/api/rewards?gamma=0.98")))
        answer = _one_answer(folder / "home-0", root)
    yield timed(NAME, "start of the server until its address", starts, note=answer)
    cold = "from the request, which comes as soon as the address is printed; jiti's own caches empty"
    yield timed(NAME, "first answer of /api/rewards", first, limit=FIRST_LIMIT_S, note=cold)
    yield timed(NAME, "first answer after a restart", later, limit=FIRST_LIMIT_S)
    yield timed(NAME, "the same again", warm)
    yield timed(NAME, "another gamma", gammas)
    yield timed(NAME, "suspects: first answer", suspects)
    yield timed(NAME, "suspects: complete, trajectories compared", complete)
    yield timed(NAME, "/api/episodes, first", listing)
    yield timed(NAME, "/api/episodes, again", listed)
    yield Line(
        NAME,
        "peak memory of the server",
        max(memory),
        "GB",
        len(memory),
        limit=MEMORY_LIMIT_GB,
        least=min(memory),
        most=max(memory),
        note="the largest VmHWM, after all of the above",
    )


def _arguments(root: Path) -> tuple[str, ...]:
    return "validate-rewards", str(root), "--annotator", "ann"


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _until_complete(server: Server) -> None:
    """Ask as the page does until the trajectories are compared too."""
    end = time.monotonic() + PATIENCE_S
    while not server.get("/api/rewards/suspects?gamma=0.98")["complete"]:
        if time.monotonic() > end:
            raise RuntimeError(f"the suspects were not complete after {PATIENCE_S:.0f} s")
        time.sleep(0.5)


def _one_answer(home: Path, root: Path) -> str:
    """What was served, so that the figures are known to be about all of it."""
    with Server(home, *_arguments(root)) as server:
        totals = server.get("/api/rewards")["totals"]
        found = len(server.get("/api/rewards/suspects")["suspects"])
    return f"{totals['episodes']:,} episodes, {totals['segments']:,} segments, {found:,} suspects at first"
