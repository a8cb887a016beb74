"""Recordings of demonstrations: complete, the same for the same seed, kept when there, whole or not at all."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import psutil
import pytest
from mcap.reader import make_reader

from jiti.annotate.simulator import read_trace
from jiti.annotate.web.session import open_session
from jiti.episodes.episode import ImageBatch, numbers
from jiti.episodes.reader import open_reader
from jiti.errors import UsageError
from jiti.runtime.sim.gl import Graphics
from jiti.runtime.sim.pictures import jpeg
from jiti.runtime.sim.record import Plan, record, recorded_metadata
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.goal import parse_goal
from jiti.tasks.judge import judge

TASK = load_catalogue().task("elegant/T2")
OTHER_GOAL = replace(TASK, itcs=(replace(TASK.itcs[0], goal="(AtEnd (On akita_black_bowl_1 plate_1))"),))
NOWHERE = Graphics(None, "not needed")
BLIND = Plan(TASK, seed=3, cameras=())
"""Without cameras, as fast as it goes."""
SEEING = Plan(TASK, seed=3, quality=1.0, picture_size=64)


@pytest.fixture(scope="module")
def seen(graphics, tmp_path_factory) -> Path:
    """A folder with one recording that has pictures."""
    folder = tmp_path_factory.mktemp("seen")
    shares: list[float] = []
    record(SEEING, folder, episodes=1, graphics=graphics, progress=lambda share, _what: shares.append(share))
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    return folder


@pytest.fixture(scope="module")
def blind(tmp_path_factory) -> Path:
    """A folder with two recordings of numbers alone, made in one process after another."""
    folder = tmp_path_factory.mktemp("blind")
    record(BLIND, folder, episodes=2, workers=1)
    return folder


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as file:
        return [(channel.topic, m.log_time, m.data) for _, channel, m in make_reader(file).iter_messages()]


def command(folder: Path, *arguments: str) -> list[str]:
    task = ["--task", "T2", "--seed", "3", "--cameras", "none", "--out", str(folder)]
    return [sys.executable, "-m", "jiti", "record", *task, *arguments]


def wait_for(what, seconds: float = 200.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


@pytest.mark.sim
def test_every_step_is_a_frame_with_all_its_pictures_and_numbers(seen):
    (path,) = seen.glob("*.mcap")
    assert path.name == "elegant-T2_0003.mcap"
    session = open_session(str(seen), annotator="ada", labels=None, tasks=None)
    (ref,) = session.reader.episodes()
    episode = session.reader.open(ref.episode_id)
    assert (episode.task, episode.task_id) == (TASK.instruction, TASK.task_id)
    assert session.task(episode) == TASK
    assert not episode.problems
    steps = episode.clock.frame_count
    assert episode.clock.reference == "/camera/front"
    assert episode.clock.rate_hz == pytest.approx(20)
    counts = {name: stream.count for name, stream in episode.streams.items()}
    assert counts.pop("/action") == steps - 1
    assert set(counts.values()) == {steps}
    assert {"/camera/wrist", "/joint_states", "/joint_velocities", "/gripper", "/eef_pose", "/proprio"} <= set(counts)
    assert {"/objects/akita_black_bowl_1", "/objects/plate_1", "/objects/flat_stove_1"} <= set(counts)
    assert {"/contacts", "/predicates", "/measures", "/fixtures/wooden_cabinet_1"} <= set(counts)
    for batch in episode.read(["/camera/front", "/camera/wrist"]):
        assert isinstance(batch, ImageBatch)
        assert batch.encoding == "jpeg"
    _, bowl = numbers(episode, "/objects/akita_black_bowl_1")
    _, plate = numbers(episode, "/objects/plate_1")
    assert np.linalg.norm(bowl[-1, :2] - plate[-1, :2]) < 0.01
    assert bowl[:, 2].max() - bowl[0, 2] > 0.02
    names = episode.streams["/contacts"].names
    _, contacts = numbers(episode, "/contacts")
    assert contacts[:, names.index("gripper-akita_black_bowl_1")].any()
    assert contacts[-1, names.index("akita_black_bowl_1-plate_1")] == 1
    assert not contacts[0, names.index("akita_black_bowl_1-plate_1")]


@pytest.mark.sim
def test_the_outcome_in_the_metadata_is_what_the_trace_says(seen):
    (path,) = seen.glob("*.mcap")
    metadata = recorded_metadata(path)
    assert (metadata["task"], metadata["seed"], metadata["quality"]) == ("elegant/T2", "3", "1")
    assert (metadata["assets"], metadata["start"], metadata["cameras"]) == ("primitive", "jitter", "front wrist")
    outcome = json.loads(metadata["outcome"])
    reader = open_reader(seen)
    trace, time_ns = read_trace(reader.open(reader.episodes()[0].episode_id))
    (itc,) = TASK.itcs
    verdict = judge(parse_goal(itc.goal), trace)
    told = outcome["itcs"][itc.itc_id]
    assert (told["satisfied"], told["step"]) == (verdict.satisfied, verdict.step)
    assert len(time_ns) == outcome["steps"] == int(metadata["steps"])
    assert outcome["success"]
    assert outcome["elegant"] == verdict.satisfied


@pytest.mark.sim
def test_rerun_takes_the_recording(seen, tmp_path):
    (path,) = seen.glob("*.mcap")
    out = tmp_path / "episode.rrd"
    rerun = Path(sys.executable).with_name("rerun")
    done = subprocess.run(
        [str(rerun), "mcap", "convert", str(path), "-o", str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert out.stat().st_size > 100_000


@pytest.mark.slow
@pytest.mark.sim
def test_a_seed_gives_the_same_messages_on_several_cores_in_other_processes_and_in_silence(blind, tmp_path):
    code = (
        "import sys\nfrom pathlib import Path\nfrom jiti.runtime.sim.record import Plan, record\n"
        "from jiti.tasks.catalogue import load_catalogue\n"
        "if __name__ == '__main__':\n"
        "    plan = Plan(load_catalogue().task('elegant/T2'), seed=3, cameras=())\n"
        "    record(plan, Path(sys.argv[1]), episodes=2, workers=2)\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    folder = tmp_path / "again"
    done = subprocess.run(
        [sys.executable, str(script), str(folder)],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
        env=os.environ | {"PYTHONHASHSEED": "1", "TMPDIR": str(tmp_path)},
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    names = ["elegant-T2_0003.mcap", "elegant-T2_0004.mcap"]
    assert sorted(p.name for p in folder.iterdir()) == names
    for name in names:
        assert messages(folder / name) == messages(blind / name)
    assert messages(blind / names[0]) != messages(blind / names[1])
    assert not list(tmp_path.glob("jiti-libero-*"))


@pytest.mark.sim
def test_a_recording_that_is_stopped_leaves_no_file(tmp_path):
    def stop(share: float, what: str) -> None:
        if what.startswith("recording el") and share > 0.05:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(BLIND, tmp_path, episodes=1, progress=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.sim
def test_a_killed_run_goes_on_where_it_was_and_leaves_no_half_file(blind, tmp_path):
    shutil.copy(blind / "elegant-T2_0003.mcap", tmp_path)
    before = (tmp_path / "elegant-T2_0003.mcap").stat()
    with subprocess.Popen(command(tmp_path, "--episodes", "2", "--workers", "1"), stdout=subprocess.PIPE) as process:
        wait_for(lambda: list(tmp_path.glob(".tmp-*")))
        process.kill()
    assert list(tmp_path.glob(".tmp-*"))  # which a kill cannot prevent
    assert [p.name for p in tmp_path.glob("[!.]*.mcap")] == ["elegant-T2_0003.mcap"]

    done = subprocess.run(
        command(tmp_path, "--episodes", "2", "--workers", "1", "--json"), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert {line.partition(":")[0] for line in done.stderr.splitlines()} <= {"Recording"}, "progress, on a slow machine"
    assert [e["kept"] for e in json.loads(done.stdout)["episodes"]] == [True, False]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["elegant-T2_0003.mcap", "elegant-T2_0004.mcap"]
    after = (tmp_path / "elegant-T2_0003.mcap").stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    assert messages(tmp_path / "elegant-T2_0004.mcap") == messages(blind / "elegant-T2_0004.mcap")


@pytest.mark.slow
@pytest.mark.sim
def test_an_interrupt_stops_every_process_and_leaves_nothing(tmp_path):
    with subprocess.Popen(
        command(tmp_path, "--episodes", "4", "--workers", "2"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # which a shell in the background ignores
    ) as process:
        wait_for(lambda: list(tmp_path.glob(".tmp-*")))
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=100)
    assert (process.returncode, out) == (130, b"")
    assert error.decode() == f"Stopped. What is whole stays in {tmp_path}; the same command goes on there.\n"
    assert not list(tmp_path.glob(".tmp-*"))


@pytest.mark.slow
@pytest.mark.sim
def test_workers_end_when_the_process_that_asked_is_killed(tmp_path):
    with subprocess.Popen(command(tmp_path, "--episodes", "6", "--workers", "2"), stdout=subprocess.PIPE) as process:
        wait_for(lambda: list(tmp_path.glob(".tmp-*")))
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2
        process.kill()
    _, alive = psutil.wait_procs(workers, timeout=60)
    assert not alive
    assert not list(tmp_path.glob(".tmp-*"))  # they took their unfinished files away


@pytest.mark.slow
@pytest.mark.sim
def test_a_folder_takes_one_run_at_a_time(tmp_path):
    with subprocess.Popen(command(tmp_path, "--episodes", "1"), stdout=subprocess.PIPE) as process:
        wait_for(lambda: list(tmp_path.glob(".tmp-*")))
        with pytest.raises(UsageError, match="another `jiti record` is at work in"):
            record(BLIND, tmp_path, episodes=1)
        process.kill()


@pytest.mark.sim
def test_without_pictures_it_says_so_and_goes_on(blind, tmp_path):
    shutil.copy(blind / "elegant-T2_0003.mcap", tmp_path)
    said: list[str] = []
    off = Graphics(None, "MUJOCO_GL=off: recording without pictures")
    plan = Plan(TASK, seed=3)
    (one,) = record(plan, tmp_path, episodes=1, graphics=off, progress=lambda _share, what: said.append(what))
    assert said == ["MUJOCO_GL=off: recording without pictures", "0 recorded, 1 kept"]
    assert (one.kept, one.cameras, one.success) == (True, (), True)


@pytest.mark.sim
@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (Plan(TASK, seed=3, cameras=(), quality=0.1), r"quality '0.5' and not '0.1'.*--out"),
        (Plan(TASK, seed=3, cameras=(), disturbance=0.2), r"disturbance '0' and not '0.2'"),
        (Plan(TASK, seed=3, cameras=(), start="file"), r"start 'jitter' and not 'file'"),
        (Plan(OTHER_GOAL, seed=3, cameras=()), r"goals '\(AtEnd .*' and not '\(AtEnd \(On "),
    ],
)
def test_recordings_of_another_plan_are_never_replaced(blind, plan, said):
    before = (blind / "elegant-T2_0003.mcap").read_bytes()
    with pytest.raises(UsageError, match=said):
        record(plan, blind, episodes=1, graphics=NOWHERE)
    assert (blind / "elegant-T2_0003.mcap").read_bytes() == before


@pytest.mark.sim
def test_a_recording_from_before_there_were_pushes_has_none(tmp_path, monkeypatch):
    about = Plan.about
    with monkeypatch.context() as before:
        without = {"disturbance"}
        before.setattr(Plan, "about", lambda *of: {k: v for k, v in about(*of).items() if k not in without})
        (made,) = record(BLIND, tmp_path, episodes=1)
    assert "disturbance" not in recorded_metadata(made.path)
    (one,) = record(BLIND, tmp_path, episodes=1)
    assert one.kept
    with pytest.raises(UsageError, match=r"disturbance 'none' and not '0\.2'"):
        record(replace(BLIND, disturbance=0.2), tmp_path, episodes=1)


def test_another_file_of_that_name_is_never_replaced(tmp_path):
    path = tmp_path / "elegant-T2_0003.mcap"
    path.write_bytes(b"not a recording")
    with pytest.raises(UsageError, match=r"elegant-T2_0003\.mcap is another recording.*Move that file away"):
        record(BLIND, tmp_path, episodes=1)
    assert path.read_bytes() == b"not a recording"


def test_what_cannot_be_recorded_is_said(tmp_path):
    with pytest.raises(UsageError, match="give 1 or more"):
        record(BLIND, tmp_path, episodes=0)
    with pytest.raises(UsageError, match="so100/T0 is not a task of simulation"):
        record(Plan(load_catalogue().task("so100/T0")), tmp_path, episodes=1)
    with pytest.raises(UsageError, match=r"--quality 1\.5 is not in 0 to 1"):
        Plan(TASK, quality=1.5)
    with pytest.raises(UsageError, match=r"--disturbance 2 is not in 0 to 1"):
        Plan(TASK, disturbance=2)
    with pytest.raises(UsageError, match="there is no scripted expert for lab/bowl"):
        record(Plan(replace(TASK, task_id="lab/bowl"), cameras=()), tmp_path, episodes=1)
    with pytest.raises(UsageError, match="a camera is named twice: front, front"):
        Plan(TASK, cameras=("front", "front"))
    with pytest.raises(UsageError, match=r"there is no camera 'side'; there are: front, wrist"):
        Plan(TASK, cameras=("side",))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("package", ["libero", "robosuite", "mujoco"])
def test_without_the_simulator_the_message_says_what_to_install(tmp_path, package):
    code = (
        f"import sys\nsys.modules[{package!r}] = None\n"  # Python's own way to say that there is none
        "from jiti.cli import main\n"
        f"sys.argv = 'jiti record --task T2 --cameras none --workers 1 --out'.split() + [{str(tmp_path)!r}]\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stderr.startswith("jiti: ")
    assert "pip install 'jiti[sim]'" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_picture_survives_as_jpeg_the_same_each_time():
    ramp = np.linspace(0, 255, 256)
    picture = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None, :], 128.0), axis=-1).astype(np.uint8)
    data = jpeg(picture)
    assert data == jpeg(picture)
    decoder: Any = av.CodecContext.create("mjpeg", "r")
    (frame,) = decoder.decode(av.Packet(data))
    back = frame.to_ndarray(format="rgb24")
    assert np.abs(back.astype(int) - picture).mean() < 3
