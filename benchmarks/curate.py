"""What `jiti curate` costs: recordings with two cameras to LeRobot v3, against lerobot's own writer, and memory.

    uv run python benchmarks/curate.py --json figures.json

Episodes are 10 s of two 640x480 JPEG cameras at 30 Hz with joints and actions at 50 Hz. The peer takes the same frames,
decoded by the same decoder, through lerobot's `add_frame` and `save_episode`: as it comes (PNG files, then an encoder a
camera in processes of their own), with its streaming encoder, and with its own default codec (AV1). Every run is a
process of its own, timed from the first recording that is opened, without imports.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

from bench import Bench
from program import arguments, run
from recordings import episodes
from report import Line, timed

from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment, new_segment_id
from jiti.annotate.store import LabelStore
from jiti.curate.export.codec import Codec
from jiti.curate.export.command import Request, curate
from jiti.curate.export.counted import Rule
from jiti.curate.export.frames import frames_of
from jiti.curate.export.numbers import read_numbers
from jiti.curate.export.plan import Choice, make_plan
from jiti.curate.export.sources import open_sources
from jiti.episodes.reader import open_reader
from jiti.episodes.video import decode_frames

SECONDS = 10
FASTER = 2.0
"""Times that we want to be faster than lerobot's writer with the same codec."""
MEMORY = 1.15
"""Of the peak with N episodes, that of 4 N may be."""


def measure(bench: Bench) -> Iterator[Line]:
    yield from _speed(bench)
    yield from _memory(bench)


def _speed(bench: Bench) -> Iterator[Line]:
    source = _labelled(bench, bench.count(4, 1))
    runs = {
        "ours h264": ("ours", "h264"),
        "lerobot h264": ("peer", "h264"),
        "lerobot h264, streaming": ("streaming", "h264"),
        "ours av1": ("ours", "av1"),
        "lerobot av1 (its default)": ("peer", "av1"),
    }
    names = list(runs)
    walls: dict[str, list[float]] = {name: [] for name in names}
    cores: dict[str, list[float]] = {name: [] for name in names}
    with bench.folder() as folder:
        for turn in range(bench.count(3, 1)):  # in turn, so that a busy moment hits all of them alike
            for number, (name, (how, codec)) in enumerate(runs.items()):
                took = _run(how, source, folder / f"{turn}-{number}", codec)
                walls[name].append(took["seconds"])
                cores[name].append(took["core_seconds"])
    what = f"{len(open_reader(source).episodes())} episodes of {SECONDS} s, two cameras"
    for title, found in (("", walls), (", processor time", cores)):
        for name in names:
            if name.startswith("lerobot"):
                yield timed("speed", f"peer: {name}{title}", found[name])
        for codec, peer in (("h264", "lerobot h264"), ("av1", "lerobot av1 (its default)")):
            limit = {"limit": 1 / FASTER, "peer": median(found[peer])}
            yield timed("speed", f"ours, {codec}: {what}{title}", found[f"ours {codec}"], **limit)


def _memory(bench: Bench) -> Iterator[Line]:
    few, many = bench.count(3, 1), bench.count(12, 4)
    with bench.folder() as folder:
        peaks = {n: _run("ours", _labelled(bench, n), folder / str(n), "h264")["peak_mib"] for n in (few, many)}
    yield Line("memory", f"peak with {few} episodes", peaks[few], "MiB", 1)
    yield Line("memory", f"peak with {many} episodes", peaks[many], "MiB", 1, limit=MEMORY, peer=peaks[few])


def _labelled(bench: Bench, count: int) -> Path:
    source = episodes(bench, SECONDS, count)
    reader = open_reader(source)
    store = LabelStore(Path(reader.labels_dir))
    for ref in reader.episodes():
        clock = (episode := reader.open(ref.episode_id)).clock
        partition = store.partition(
            "bench", ref.episode_id, Recording(clock.frame_count, clock.rate_hz, episode.fingerprint)
        )
        if not partition.segments:
            row = Segment(
                new_segment_id(), ref.episode_id, "generic/pose_alignment", "pose_alignment", 100, 124, 0, 0, 1
            )
            partition.apply("mark", [row], based_on=0)
    return source


def _run(how: str, source: Path, out: Path, codec: str) -> dict[str, float]:
    command = [sys.executable, __file__, "--one", how, str(source), str(out), codec]
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "SVT_LOG": "1"}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise SystemExit(f"{how}, {codec}: {ended.stderr[-3000:]}")
    return json.loads(ended.stdout.splitlines()[-1])


def _one(how: str, source: Path, out: Path, codec: str) -> None:
    """One run, in this process; prints what it took."""
    if how == "ours":
        begin, busy = time.perf_counter(), _core_seconds()
        curate(Request(sources=(str(source),), out=out, codec=codec))
    else:
        import lerobot.datasets.lerobot_dataset  # noqa: F401

        begin, busy = time.perf_counter(), _core_seconds()
        _peer(source, out, codec, streaming=how == "streaming")
    seconds, core_seconds = time.perf_counter() - begin, _core_seconds() - busy
    print(json.dumps({"seconds": seconds, "core_seconds": core_seconds, "peak_mib": _peak_mib()}))


def _peer(source: Path, out: Path, codec: str, *, streaming: bool) -> None:
    from lerobot.configs import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    if codec == "h264":
        own = Codec("h264")
        options = {key: value for key, value in own.options.items() if key not in ("g", "crf", "preset")}
        encoder = RGBEncoderConfig(vcodec="h264", g=2, crf=own.crf, preset=own.options["preset"], extra_options=options)
    else:
        encoder = RGBEncoderConfig()
    sources = open_sources([str(source)], labels=[], tasks=None, rule=Rule())
    plan = make_plan(sources, Choice(rule="majority", gamma=0.98))
    features = {key: {**shape.to_info(), "shape": shape.shape} for key, shape in plan.shapes.items()}
    dataset = LeRobotDataset.create(
        "bench/peer", plan.fps, features, root=out, rgb_encoder=encoder, streaming_encoding=streaming
    )
    for planned in plan.episodes:
        episode = sources[0].reader.open(planned.episode_id)
        numbers = read_numbers(planned.features, episode, frames_of(episode.clock, None), None, planned.title)
        cameras = {f.key: decode_frames(episode, f.camera, range(planned.frames)) for f in planned.features if f.camera}
        for frame in range(planned.frames):
            row: dict[str, Any] = {key: values[frame] for key, values in numbers.items()}
            row |= {key: next(pictures)[1] for key, pictures in cameras.items()}
            dataset.add_frame({**row, "task": planned.instruction})
        dataset.save_episode()
    dataset.finalize()


def _peak_mib() -> float:
    """Of this program; `ru_maxrss` would begin with what the process had that started it."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024


def _core_seconds() -> float:
    """Processor time of this process and of those that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    if sys.argv[1:2] == ["--one"]:
        how, source, out, codec = sys.argv[2:]
        _one(how, Path(source), Path(out), codec)
        return
    run(arguments(__doc__).parse_args(), measure)


if __name__ == "__main__":
    main()
