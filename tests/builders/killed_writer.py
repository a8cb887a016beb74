"""Annotators that are killed at random moments, and what they leave behind.

Run as `python -m tests.builders.killed_writer FOLDER ROUNDS SEED`. A child edits a partition as fast as it can and says
over a pipe what it is about to do and what was acknowledged; the parent kills it without warning, opens the
partition and compares. Ends with exit code 1 and the difference when there is one.
"""

import os
import random
import signal
import sys
import time
import traceback
from pathlib import Path

from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import decode, to_segments
from jiti.annotate.segments import Segment
from tests.builders.labels import RECORDING, segment

State = dict[str, tuple[int, int | None]]
"""Start frame and verdict by segment id."""


def state_of(segments: tuple[Segment, ...] | list[Segment]) -> State:
    return {s.segment_id: (s.start_frame, s.reward) for s in segments}


def told(version: int, state: State) -> str:
    return f"{version} {sorted(state.items())}"


def step(partition: Partition, rng: random.Random) -> tuple[State, list[Segment], list[str]]:
    """A random edit and the state that it leads to."""
    state = state_of(partition.segments)
    chosen = rng.choice(partition.segments) if state else None
    if chosen is None or (len(state) < 40 and rng.random() < 0.5):
        new = segment(rng.randrange(200), 290, rng.choice((0, 1, None)))
        return {**state, new.segment_id: (new.start_frame, new.reward)}, [new], []
    if rng.random() < 0.3:
        return {k: v for k, v in state.items() if k != chosen.segment_id}, [], [chosen.segment_id]
    moved = chosen.changed(start_frame=(chosen.start_frame + 1) % 290)
    return {**state, chosen.segment_id: (moved.start_frame, moved.reward)}, [moved], []


def edit_until_killed(folder: Path, pipe: int, rng: random.Random) -> None:
    partition = Partition(folder, "anna", "ep", RECORDING)
    while True:
        expected, put, remove = step(partition, rng)
        os.write(pipe, f"try {told(partition.version + 1, expected)}\n".encode())
        version = partition.apply("edit", put, remove, based_on=partition.version)
        os.write(pipe, f"ack {told(version, expected)}\n".encode())


def one_round(folder: Path, rng: random.Random) -> str:
    """What is wrong after one kill; empty when nothing is."""
    opened = Partition(folder, "anna", "ep", RECORDING)
    acknowledged = told(opened.version, state_of(opened.segments))
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            edit_until_killed(folder, writer, rng)
        except BaseException:
            traceback.print_exc()
            os._exit(70)
    os.close(writer)
    with os.fdopen(reader) as said:
        lines = [said.readline()] if rng.random() < 0.8 else []  # the others are killed while they open it
        time.sleep(rng.uniform(0, 0.02))
        os.kill(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        lines = [line for line in (*lines, *said) if line.endswith("\n")]
    if code != -signal.SIGKILL:
        return f"the writer ended by itself with {code}"

    partition = Partition(folder, "anna", "ep", RECORDING)
    found = told(partition.version, state_of(partition.segments))
    tried = ""
    for line in lines:
        word, _, rest = line.strip().partition(" ")
        if word == "ack":
            acknowledged, tried = rest, ""
        else:
            tried = rest
    if found not in (acknowledged, tried):
        return f"found {found}\nacknowledged was {acknowledged}\ntried was {tried}"
    if partition.version:
        table, info = decode(folder / "segments" / "annotator=anna" / "ep.parquet")
        if told(info.version or 0, state_of(to_segments(table))) != found:
            return f"found {found}\nthe Parquet file is at {info.version}: {state_of(to_segments(table))}"
    return ""


def main() -> int:
    folder, rounds, rng = Path(sys.argv[1]), int(sys.argv[2]), random.Random(int(sys.argv[3]))
    # What the first save imports is there before the children are: else they are killed while they import.
    Partition(folder / "warm", "anna", "ep", RECORDING).apply("mark", [segment()], based_on=0)
    for number in range(rounds):
        if wrong := one_round(folder, rng):
            print(f"round {number}: {wrong}")
            return 1
    after = Partition(folder, "anna", "ep", RECORDING)
    print(f"{rounds} kills, {after.version} edits")
    return 0


if __name__ == "__main__":
    sys.exit(main())
