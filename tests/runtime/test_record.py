"""Recordings of the demonstration: complete, the same for the same seed, kept when there."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from mcap.reader import make_reader

from jiti.annotate.labels import read_segments
from jiti.episodes.episode import ImageBatch, numbers
from jiti.episodes.reader import open_reader
from jiti.errors import UsageError
from jiti.runtime.sim.demo import demo
from jiti.runtime.sim.gl import Graphics
from jiti.runtime.sim.lift import INSTRUCTION, TASK_FILE, TASK_ID
from jiti.runtime.sim.record import jpeg, quaternion_xyzw, record_demo, recorded_metadata
from jiti.tasks.catalogue import load_catalogue

SEED = 7
NOWHERE = Graphics(None, "not needed")


@pytest.fixture(scope="module")
def recorded(graphics, tmp_path_factory) -> Path:
    """A folder with one recording."""
    folder = tmp_path_factory.mktemp("demo")
    shares: list[float] = []
    record_demo(folder, seed=SEED, graphics=graphics, progress=lambda share, _what: shares.append(share))
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    return folder


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as file:
        return [(channel.topic, m.log_time, m.data) for _, channel, m in make_reader(file).iter_messages()]


def run_python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
        env=os.environ | environment,
    )


@pytest.mark.sim
def test_every_step_is_a_frame_with_all_its_pictures_and_numbers(recorded):
    reader = open_reader(recorded)
    (ref,) = reader.episodes()
    episode = reader.open(ref.episode_id)
    assert episode.task == INSTRUCTION
    assert not episode.problems
    steps = episode.clock.frame_count
    assert episode.clock.reference == "/camera/agentview"
    assert episode.clock.rate_hz == pytest.approx(20)
    assert {n: s.count for n, s in episode.streams.items()} == {
        **dict.fromkeys(("/camera/agentview", "/camera/eye_in_hand", "/joint_states", "/joint_velocities"), steps),
        **dict.fromkeys(("/gripper", "/eef_pose", "/cube_pose", "/contact"), steps),
        "/action": steps - 1,
    }
    for batch in episode.read(["/camera/agentview", "/camera/eye_in_hand"]):
        assert isinstance(batch, ImageBatch)
        assert batch.encoding == "jpeg"
    _, cube = numbers(episode, "/cube_pose")
    assert cube[-1, 2] - cube[0, 2] > 0.1
    metadata = recorded_metadata(recorded / "pick_000.mcap")
    assert (metadata["steps"], metadata["lifted"]) == (str(steps), "true")
    assert json.loads(metadata["manner"]).keys() == {"aside_m", "turned_rad", "low_m", "hurried"}


@pytest.mark.sim
def test_a_seed_gives_the_same_bytes_in_another_process_and_in_silence(recorded, graphics, tmp_path):
    code = (
        "import sys\nfrom pathlib import Path\nfrom jiti.runtime.sim.record import record_demo\n"
        f"record_demo(Path(sys.argv[1]), seed={SEED})\n"
    )
    done = run_python(code, str(tmp_path), MUJOCO_GL=graphics.backend or "", PYTHONHASHSEED="1")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert [p.name for p in tmp_path.iterdir()] == ["pick_000.mcap"]
    assert messages(tmp_path / "pick_000.mcap") == messages(recorded / "pick_000.mcap")


@pytest.mark.sim
def test_a_recording_that_is_stopped_leaves_no_file(graphics, tmp_path):
    def stop(share: float, what: str) -> None:
        if what.startswith("recording") and share > 0.05:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_demo(tmp_path, seed=SEED, graphics=graphics, progress=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.sim
def test_the_demo_proposes_a_window_for_each_constraint_and_a_second_run_changes_nothing(recorded):
    task = load_catalogue(TASK_FILE).task(TASK_ID)
    summary = demo(recorded, seed=SEED)
    (e,) = summary.episodes
    assert (e.proposals, e.lifted, len(e.cameras)) == (len(task.itcs), True, 2)
    assert str(recorded / "pick_000.mcap") in str(summary)
    assert summary.task_file.read_bytes() == TASK_FILE.read_bytes()
    rows = read_segments(summary.labels_dir).to_pylist()
    assert {(r["annotator"], r["status"], r["source"], r["reward"]) for r in rows} == {
        ("signal", "proposed", "signal", None)
    }
    assert {r["episode_id"] for r in rows} == {e.episode_id}
    assert {r["itc_id"] for r in rows} == {itc.itc_id for itc in task.itcs}
    assert all(0 <= r["start_frame"] <= r["end_frame"] < e.frame_count for r in rows)

    again = demo(recorded, seed=SEED)
    assert again == summary
    assert read_segments(summary.labels_dir).to_pylist() == rows


@pytest.mark.sim
def test_a_stopped_demo_goes_on_and_without_pictures_it_records_numbers_and_says_so(recorded, tmp_path):
    kept = tmp_path / "pick_000.mcap"
    shutil.copy(recorded / kept.name, kept)
    before = kept.stat()
    code = (
        "import sys\nfrom pathlib import Path\nfrom jiti.runtime.sim.demo import demo\n"
        "say = lambda share, what: print(what) if share in (0, 1) else None\n"
        f"print(demo(Path(sys.argv[1]), episodes=2, seed={SEED}, progress=say))\n"
    )
    done = run_python(code, str(tmp_path), MUJOCO_GL="off")
    assert (done.returncode, done.stderr) == (0, "")
    assert "MUJOCO_GL=off: recording without pictures" in done.stdout
    assert "1 recorded, 1 kept" in done.stdout
    assert "pick_000.mcap: " in done.stdout
    assert "2 cameras, 4 proposals, cube lifted" in done.stdout
    assert "0 cameras, 4 proposals, cube lifted" in done.stdout
    assert recorded_metadata(tmp_path / "pick_001.mcap")["pictures"] == "none"
    after = kept.stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_another_recording_is_never_replaced(tmp_path):
    path = tmp_path / "pick_000.mcap"
    path.write_bytes(b"not a recording")
    with pytest.raises(UsageError, match=r"pick_000\.mcap is another recording.*move that file away"):
        record_demo(tmp_path, graphics=NOWHERE)
    assert path.read_bytes() == b"not a recording"


@pytest.mark.sim
def test_another_seed_needs_another_folder(recorded):
    with pytest.raises(UsageError, match=rf"a recording with seed {SEED}.*Choose another folder for seed 1"):
        record_demo(recorded, seed=1, graphics=NOWHERE)


def test_the_task_file_is_found_by_its_instruction_with_one_constraint_a_criterion():
    task = load_catalogue(TASK_FILE).match(INSTRUCTION)
    assert task is not None
    assert task.task_id == TASK_ID
    assert len({itc.criterion for itc in task.itcs}) == len(task.itcs) == 4


@pytest.mark.parametrize("package", ["mujoco", "robosuite"])
def test_without_the_simulator_the_message_says_what_to_install(tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)  # Python's own way to say that there is none
    with pytest.raises(UsageError, match=rf"{package}, which simulates .* pip install 'jiti\[sim\]'"):
        record_demo(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_no_episode_is_no_demo(tmp_path):
    with pytest.raises(UsageError, match="give 1 or more"):
        record_demo(tmp_path, episodes=0)


def test_a_picture_survives_as_jpeg_the_same_each_time():
    ramp = np.linspace(0, 255, 256)
    picture = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None, :], 128.0), axis=-1).astype(np.uint8)
    data = jpeg(picture)
    assert data == jpeg(picture)
    decoder: Any = av.CodecContext.create("mjpeg", "r")
    (frame,) = decoder.decode(av.Packet(data))
    back = frame.to_ndarray(format="rgb24")
    assert np.abs(back.astype(int) - picture).mean() < 3


@pytest.mark.parametrize("angle", [0.0, 0.5, 3.1, np.pi])
def test_a_quaternion_turns_as_its_matrix_does(angle):
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    x, y, z, w = quaternion_xyzw(matrix)
    assert w >= 0
    np.testing.assert_allclose([abs(x), y, z, w], [np.sin(angle / 2), 0, 0, np.cos(angle / 2)], atol=1e-9)
    assert x * sin >= 0
