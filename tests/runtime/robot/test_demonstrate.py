"""Demonstrations on the virtual arm: the arm follows without a jump or has no torque, and what was recorded is kept."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread
from time import sleep

import numpy as np
import pytest

from jiti.episodes.episode import numbers
from jiti.episodes.reader import open_reader
from jiti.errors import RobotError, UsageError
from jiti.runtime.robot.demonstrate import RecordRequest, record_robot
from jiti.runtime.robot.demonstrations import path_of
from jiti.runtime.robot.loop import RETURN_STEP
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.virtual import Faults, State, VirtualArm, registers
from jiti.runtime.robot.virtual.demonstrator import REST, now
from jiti.runtime.robot.virtual.hand import smooth
from jiti.runtime.sim.record import recorded_metadata
from jiti.tasks.catalogue import load_catalogue
from tests.builders import robot_record
from tests.builders.robot_record import at_terminal

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""
CATALOGUE = load_catalogue()
OFF = [0] * 6
LIFTED = np.array([0.9, -0.9, 1.2, -0.5, 0.4, 0.6])
"""Far from where an arm rests, in the air."""


@pytest.fixture(autouse=True)
def _no_questions(monkeypatch):
    monkeypatch.setattr("builtins.input", lambda prompt="": pytest.fail(f"someone asks: {prompt}"))


def asked(settings: RobotSettings, out: Path, **more) -> RecordRequest:
    return RecordRequest(settings, **{"task": "so100/T2", "episodes": 1, "seconds": 3.0, "out": out / "demos"} | more)


def recorded(request: RecordRequest, recording=lambda: None):
    """What became of it, and what was said; `recording` is called whenever an episode begins."""
    said: list[str] = []

    def say(one: str) -> None:
        said.append(one)
        if one.startswith("Recording"):
            recording()

    return record_robot(request, CATALOGUE, say, cameras={}), said


def opened(folder: Path, seed: int = 0, task: str = "so100/T2"):
    path = path_of(folder, task, seed)
    reader = open_reader(path)
    return path, reader.open(reader.episodes()[0].episode_id)


def moved(arm: VirtualArm, *places: np.ndarray, seconds: float = 1.5) -> None:
    """A hand begins to move an arm."""
    path = smooth([now(arm.state()), places[0]], seconds)
    for before, after in pairwise(places):
        path = path.then(smooth([before, after], seconds))
    arm.lead(path)


@contextmanager
def watched(arm: VirtualArm) -> Iterator[list[tuple[State, list[int]]]]:
    """States and torques of an arm meanwhile."""
    seen: list[tuple[State, list[int]]] = []
    over = Event()

    def watch() -> None:
        while not over.wait(0.02):
            seen.append((arm.state(), [memory[registers.TORQUE_ENABLE] for memory in arm.memories().values()]))

    thread = Thread(target=watch)
    thread.start()
    try:
        yield seen
    finally:
        over.set()
        thread.join()


def test_an_arm_goes_slowly_to_its_leader_and_then_follows_it(arm, leader_arm, led_settings, torque, tmp_path, until):
    moved(leader_arm, LIFTED)
    until(leader_arm.led)
    before = now(leader_arm.state())
    turn = smooth([before, before], 1.0).then(smooth([before, before + [0.3, 0, 0, 0, 0, 0]], 1.0))
    with watched(arm) as seen:
        done, _ = recorded(asked(led_settings, tmp_path, seconds=5.0), lambda: leader_arm.lead(turn))
    assert done.problem is None
    assert torque() == OFF
    _, episode = opened(tmp_path / "demos")
    _, joints = numbers(episode, "/joints")
    _, sent = numbers(episode, "/action")
    _, led = numbers(episode, "/action_asked")
    assert len(sent) == 150
    assert joints[0, :5] == pytest.approx(np.degrees(LIFTED[:5]), abs=8), "it is there when the recording begins"
    assert sent[-1, 0] == pytest.approx(np.degrees(LIFTED[0] + 0.3), abs=3)
    assert np.abs(np.diff(sent, axis=0)).max() <= led_settings.max_step + 1e-6
    np.testing.assert_allclose(sent[-1], led[-1], atol=1e-6)
    assert joints[-1] == pytest.approx(led[-1], abs=5)
    times = np.array([state.time_s for state, _ in seen])
    angles = np.degrees([now(state)[:5] for state, _ in seen])
    steps = np.flatnonzero(np.diff(times) > 0)
    speeds = np.abs(np.diff(angles, axis=0)[steps]) / np.diff(times)[steps, None]
    on = np.array([any(torque) for _, torque in seen])[1:][steps]
    assert on.any()
    assert speeds[on].max() < 2 * RETURN_STEP * led_settings.fps, "degrees a second"


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        (Faults(mute=frozenset({2})), r"servo 2 \(shoulder_lift\) of the leader does not answer"),
        (Faults(unplugged=True), "plug the leader's USB cable in again"),
    ],
)
def test_a_leader_that_goes_mute_stops_it(arm, leader_arm, led_settings, torque, tmp_path, until, faults, message):
    def strike() -> None:
        until(lambda: any(torque()))
        sleep(1.5)
        leader_arm.faults = faults

    thread = Thread(target=strike)
    thread.start()
    done, said = recorded(asked(led_settings, tmp_path, seconds=30.0, episodes=2))
    thread.join()
    assert isinstance(done.problem, RobotError)
    with pytest.raises(RobotError, match=message):
        raise done.problem
    assert torque() == OFF
    assert any("Take hold of the arm" in one for one in said)
    path, episode = opened(tmp_path / "demos")
    assert len(numbers(episode, "/joints")[1]) > 10
    assert "leader" in recorded_metadata(path)["ended"]
    assert [one.stopped for one in done.there.episodes] == [True]


def test_by_hand_it_never_has_torque_and_an_action_is_the_next_place(arm, settings, torque, tmp_path):
    moved(arm, LIFTED, REST)
    with watched(arm) as seen:
        done, _ = recorded(asked(settings, tmp_path))
    assert done.problem is None
    assert len(seen) > 20
    assert all(torque == OFF for _, torque in seen)
    path, episode = opened(tmp_path / "demos")
    _, joints = numbers(episode, "/joints")
    _, actions = numbers(episode, "/action")
    assert len(joints) == len(actions) == 90
    assert np.ptp(joints[:, 0]) > 30, "degrees"
    np.testing.assert_array_equal(actions[:-1], joints[1:])
    np.testing.assert_array_equal(actions[-1], joints[-1])
    found = recorded_metadata(path)
    assert {key: found[key] for key in ("task", "robot", "how", "seed", "ended", "steps")} == {
        "task": "so100/T2", "robot": "so100", "how": "by hand", "seed": "0", "ended": "time", "steps": "90"
    }  # fmt: skip


def test_as_many_as_asked_are_there_in_the_end(settings, tmp_path):
    short = asked(settings, tmp_path, seconds=0.5, episodes=2)
    first, _ = recorded(short)
    before = {path: path.read_bytes() for path in (tmp_path / "demos").glob("*.mcap")}
    left = tmp_path / "demos" / ".tmp-1-0a0a0a0a-so100-T2_0002.mcap"
    left.write_bytes(b"of a run that was killed")
    second, _ = recorded(replace(short, episodes=3))
    assert [one.kept for one in first.there.episodes] == [False, False]
    assert [(one.seed, one.kept) for one in second.there.episodes] == [(0, True), (1, True), (2, False)]
    assert all(path.read_bytes() == content for path, content in before.items())
    assert not left.exists()
    again, said = recorded(replace(short, episodes=3))
    assert said == [], "nothing is opened for nothing"
    assert json.loads(again.there.to_json())["episodes"][2]["kept"]
    with pytest.raises(UsageError, match=r"recorded with robot 'so100' and not 'so101'"):
        recorded(replace(short, settings=replace(settings, kind="so101")))


def test_sigterm_in_the_middle_keeps_what_was_recorded_and_the_next_run_goes_on(
    arm, leader_arm, led_settings, torque, tmp_path, until
):
    with program(led_settings, tmp_path) as recording:
        until(lambda: any(torque()))
        sleep(2)
        os.kill(recording.pid, signal.SIGTERM)
        told, _ = recording.communicate(timeout=60)
    assert recording.returncode == 128 + signal.SIGTERM, told
    assert "so100-T2_0000.mcap was stopped in the middle (stopped by SIGTERM)" in told
    assert torque() == OFF
    path, episode = opened(tmp_path / "demos")
    assert len(numbers(episode, "/joints")[1]) > 10
    before = path.read_bytes()
    done, _ = recorded(asked(led_settings, tmp_path, seconds=0.5, episodes=2))
    assert [(one.kept, one.stopped) for one in done.there.episodes] == [(True, True), (False, False)]
    assert path.read_bytes() == before
    assert not list((tmp_path / "demos").glob(".tmp-*"))


def test_enter_begins_and_ends_r_records_anew_and_space_stops(settings, torque, tmp_path):
    first = path_of(tmp_path / "demos", "so100/T2", 0)
    with at_terminal(command(settings, tmp_path), tmp_path / "said.txt") as keyboard:
        keyboard.wait_for("so100-T2_0000.mcap is next.\nLay the things out.\n[Enter] begin  [Space] stop")
        assert not first.exists()
        keyboard.press("\n", "Recording")
        sleep(1)
        keyboard.press("\n", "[Enter] begin  [r] record so100-T2_0000.mcap anew")
        before = recorded_metadata(first)
        assert before["ended"] == "Enter"
        keyboard.press("rr", "[Enter] begin  [Space] stop")
        assert not first.exists()
        keyboard.press("\n", "Recording")
        sleep(0.5)
        keyboard.press("\x7f", "[Enter] begin")
        assert not first.exists(), "Backspace in the middle"
        keyboard.press("\n", "Recording")
        sleep(2)
        keyboard.press("\n", "[Enter] begin")
        assert int(recorded_metadata(first)["steps"]) > int(before["steps"])
        keyboard.press("\n", "Recording")
        sleep(0.5)
        keyboard.press("\n", "[Enter] end  [r] record so100-T2_0001.mcap anew")
        keyboard.press("r", "[Enter] begin  [Space] stop")
        keyboard.press("r", "")
        keyboard.press(" ", "1 of 2 episodes")
        assert keyboard.program.wait(60) == 0
    assert torque() == OFF
    assert [path.name for path in sorted((tmp_path / "demos").iterdir())] == [first.name, f"{first.stem}.ticks.parquet"]


def test_space_in_the_middle_stops_an_arm_that_follows(leader_arm, led_settings, torque, tmp_path):
    with at_terminal(command(led_settings, tmp_path), tmp_path / "said.txt") as keyboard:
        keyboard.wait_for("[Enter] begin")
        assert torque() == OFF
        keyboard.press("\n", "Recording")
        sleep(1)
        keyboard.press(" ", "was stopped in the middle (stopped by Space)")
        assert keyboard.program.wait(60) == 0
    assert torque() == OFF
    assert len(numbers(opened(tmp_path / "demos")[1], "/joints")[1]) > 5


@pytest.mark.parametrize("leader", ["", "virtual"])
def test_a_virtual_hand_closes_the_drawer(leader, tmp_path):
    settings = RobotSettings(port="virtual", leader=leader)
    done, said = recorded(asked(settings, tmp_path, task="so100/T5", seed=3, seconds=30.0, quality=1.0))
    assert done.problem is None
    (one,) = done.there.episodes
    assert one.how == ("leader" if leader else "by hand")
    assert one.ended == "the hand was done"
    found = recorded_metadata(one.path)
    assert found["manner"] == "careful"
    joints = numbers(opened(tmp_path / "demos", 3, "so100/T5")[1], "/joints")[1]
    assert np.ptp(joints[:, 0]) > 30
    assert any("ended: the hand was done" in told for told in said)


def command(settings: RobotSettings, folder: Path) -> list[str]:
    """Two episodes that a person ends."""
    config = robot_record.write_settings(folder / "arm.toml", settings)
    options = ["--out", str(folder / "demos"), "--episodes", "2", "--seconds", "600"]
    return robot_record.jiti("record", "--robot-config", config, "--task", "so100/T2", *options)


def program(settings: RobotSettings, folder: Path) -> subprocess.Popen:
    """Without a terminal."""
    return subprocess.Popen(
        command(settings, folder),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=robot_record.environment(),
    )
