"""Whole rollouts on the virtual arm: whatever ends one, the arm has no torque, and what was recorded is kept."""

import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pyarrow.parquet as pq
import pytest

from jiti.annotate.labels import read_segments
from jiti.episodes.episode import numbers
from jiti.episodes.reader import open_reader
from jiti.errors import RobotError, UsageError
from jiti.runtime.guidance import Decision
from jiti.runtime.robot.command import run_robot
from jiti.runtime.robot.request import RobotRequest
from jiti.runtime.robot.run import Recorded
from jiti.runtime.robot.tick import Tick
from jiti.runtime.robot.virtual import Faults
from jiti.runtime.sim.record import recorded_metadata
from jiti.tasks.catalogue import load_catalogue
from tests.builders import robot_agents, robot_rollout

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""
CATALOGUE = load_catalogue()
OFF = [0] * 6


@pytest.fixture
def asked(settings, tmp_path) -> RobotRequest:
    """Three seconds, quick decisions."""
    return RobotRequest(
        settings,
        task="so100/T2",
        policy="hub/p",
        critic="hub/c",
        guidance=("jiti",),
        tau=0.5,
        seconds=3.0,
        out=tmp_path,
    )


def ran(request, make_agent=robot_agents.quick, **more):
    said: list[str] = []
    done = run_robot(request, CATALOGUE, said.append, make_agent=make_agent, **more)
    return done, said


def recorded(folder: Path):
    """The only recording, as jiti reads it, and what its metadata says of its end."""
    (path,) = folder.rglob("*.mcap")
    reader = open_reader(path)
    return path, reader.open(reader.episodes()[0].episode_id)


def test_an_episode_moves_the_arm_and_is_kept(arm, asked, torque, tmp_path):
    looked: list[tuple[Recorded, list[int]]] = []
    done, _ = ran(replace(asked, episodes=2), after_episode=lambda one: looked.append((one, torque())))
    assert done.problem is None
    assert torque() == OFF
    first, second = done.report.episodes
    assert (first.number, second.number, first.acting) == (0, 1, 90)
    assert first.held == 0
    assert 0 < first.triggered < first.decisions
    assert first.changed == first.triggered
    assert [(one.turn.number, off) for one, off in looked] == [(0, OFF), (1, OFF)]
    path = looked[0][0].turn.path
    episode = open_reader(path).open("so100-T2_0000")
    assert episode.task_id == "so100/T2"
    times, sent = numbers(episode, "/action")
    _, joints = numbers(episode, "/joints")
    assert len(sent) == first.steps
    assert np.ptp(joints[:, 0]) > 20, "degrees that the first joint has swept"
    after = [angle * 180 / np.pi for angle in arm.state().joints.values()]
    assert after[:5] == pytest.approx(joints[0, :5], abs=8), "it went back to where it lay"
    assert np.abs(np.diff(sent, axis=0)).max() <= asked.settings.max_step + 1e-6
    decided_ns, values = numbers(episode, "/decisions")
    assert len(values) == first.decisions
    assert set(decided_ns) <= set(times), "at the state that it was made on"
    ticks = pq.read_table(path.with_suffix(".ticks.parquet")).to_pylist()
    assert [tick["tick"] for tick in ticks] == list(range(first.steps))
    decisions = pq.read_table(path.with_suffix(".decisions.parquet")).to_pylist()
    assert all(d["sample_s"] > 0 and d["round_trip_s"] >= d["sample_s"] + d["score_s"] for d in decisions)
    assert all(d["arrived"] - d["frame"] >= d["dropped"] for d in decisions)
    assert json.loads(done.to_json())["episodes"][0]["held"] == 0


def test_a_decision_that_takes_longer_than_its_actions_is_waited_for(asked, torque):
    slow = replace(asked, settings=replace(asked.settings, execute=1), guidance=("full",), seconds=5.0)
    done, _ = ran(slow, make_agent=robot_agents.short_chunks)
    (episode,) = done.report.episodes
    assert episode.held > 10
    assert episode.acting - episode.held > 10
    assert torque() == OFF


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (robot_agents.nan, "has nan for elbow_flex"),
        (robot_agents.stall, "have not decided anything for 2 s"),
        (robot_agents.crash, "the process of policy and critic has ended with 9"),
    ],
)
def test_a_policy_that_fails_stops_the_arm(arm, asked, torque, tmp_path, agent, message):
    done, said = ran(replace(asked, seconds=30.0), make_agent=agent)
    assert isinstance(done.problem, RobotError)
    assert message in str(done.problem)
    assert torque() == OFF
    assert any("Take hold of the arm" in one for one in said)
    _, episode = recorded(tmp_path)
    assert len(numbers(episode, "/action")[1]) == done.report.episodes[0].steps > 5


def test_what_is_out_of_range_is_clamped_and_counted(asked, torque):
    done, _ = ran(asked, make_agent=robot_agents.far)
    assert done.problem is None
    assert done.report.episodes[0].clamped > 10
    assert torque() == OFF


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        (Faults(mute=frozenset({3})), r"servo 3 \(elbow_flex\) does not answer. Check the cable"),
        (Faults(jam=frozenset({1})), r"servo 1 \(shoulder_pan\) (stays|reports an overload) .* Free"),
        (Faults(unplugged=True), "is gone in the middle of work"),
    ],
)
def test_a_fault_in_the_middle_of_an_episode_leaves_what_was_recorded(arm, asked, tmp_path, until, faults, message):
    def strike() -> None:
        until(lambda: abs(arm.state().joints["shoulder_pan"]) > 0.1)
        arm.faults = faults

    thread = Thread(target=strike)
    thread.start()
    done, _ = ran(replace(asked, seconds=30.0))
    thread.join()
    assert done.problem is not None
    with pytest.raises(RobotError, match=message):
        raise done.problem
    _, episode = recorded(tmp_path)
    assert len(numbers(episode, "/action")[1]) == done.report.episodes[0].steps > 5


def test_recordings_are_numbered_on_and_none_is_replaced(asked, tmp_path):
    folder = tmp_path / "jiti"
    folder.mkdir()
    for number in (0, 7):
        (folder / f"so100-T2_{number:04d}.mcap").write_bytes(b"")
    done, _ = ran(replace(asked, seconds=0.5))
    assert [(e.number, Path(e.recording or "").name) for e in done.report.episodes] == [(8, "so100-T2_0008.mcap")]
    with pytest.raises(UsageError, match=r"so100-T2_0007.mcap is there already"):
        ran(replace(asked, seed=6, episodes=2))


def test_tau_is_measured_on_episodes_of_their_own_and_taken_from_then_on(asked, tmp_path):
    free = replace(asked, tau=None, guidance=())
    done, said = ran(replace(free, calibrate_tau=0.5, episodes=2))
    assert done.problem is None
    assert sum(e.triggered for e in done.report.episodes) == 0
    assert any("decisions in 2 episodes exceed it" in one for one in said)
    assert {path.parent.name for path in tmp_path.rglob("*.mcap")} == {"calibration"}
    done, _ = ran(free)
    (episode,) = done.report.episodes
    assert done.report.taken["tau"] == json.loads((tmp_path / "tau.json").read_bytes())["tau"]
    assert 0 < episode.triggered < episode.decisions
    with pytest.raises(UsageError, match="calibrated with window 2 and not 3"):
        ran(replace(free, window=3))


def test_what_is_shown_of_a_blind_episode_has_no_values_of_the_critic(tmp_path):
    from jiti.runtime.robot.live import LiveArm
    from jiti.runtime.rollout.decide import Decided

    sizes = {}
    for blind in (False, True):
        shown = LiveArm(tmp_path / f"{blind}.rrd", None, ("gripper",), (), tau=0.5, blind=blind)
        decision = Decision(0, 0.7, 0.1, True, (0.7, 0.9), 1, 0.1, 0.1)
        shown.decided(Decided(decision, 0, np.zeros((2, 3, 1)), 0.1))
        shown.close()
        sizes[blind] = (tmp_path / f"{blind}.rrd").read_bytes().count(b"values/triggered")
    assert sizes[False] > sizes[True]


def test_a_dry_run_says_where_it_would_go(arm, asked, torque, tmp_path):
    before = arm.memories()[1].read(0, 56)
    done, said = ran(replace(asked, dry_run=True))
    assert done.problem is None
    assert any("shoulder_pan 0 -> " in one for one in said)
    assert not list(tmp_path.rglob("*.mcap"))
    assert arm.memories()[1].read(0, 56) == before
    assert torque() == OFF


def test_it_is_shown_live_and_that_is_kept(asked, tmp_path):
    from jiti.runtime.robot.live import LiveArm
    from jiti.runtime.robot.recording import Recording

    joints = ("shoulder_pan", "gripper")
    shown = LiveArm(tmp_path / "one.rrd", None, joints, (), tau=0.5)
    recording = Recording(None, joints, (), shown=shown)
    for number in range(5):
        sent = dict.fromkeys(joints, 1.0 * number)
        seen = {f"{name}.pos": value for name, value in sent.items()}
        recording.ticked(Tick(number, number, seen, sent, sent, (), True, 0.03, 0.0, 0.0, 0.0))
    recording.finish("time")
    assert b"joints/gripper" in (tmp_path / "one.rrd").read_bytes()
    assert len(recording.ticks) == 5


WITHOUT = ({"tau_scale": 0.5}, {"pick": "worst"}, {"candidates": 4})
"""What has no effect on a calibration."""


def test_what_is_missing_is_told_before_the_arm_is_touched(asked):
    for change, message in (
        ({"policy": None}, "pass --policy"),
        ({"task": None}, "pass --task|Pass --task"),
        ({"critic": None}, "needs a critic"),
        ({"tau": None}, "needs a threshold, and .* has none: pass --calibrate-tau"),
        ({"calibrate_tau": 0.3}, "leave --guidance, --tau"),
        *(({"calibrate_tau": 0.3, "guidance": (), "tau": None, **own}, "--tau-scale, --pick") for own in WITHOUT),
        ({"guidance": ("none", "jiti")}, "a person compares several: add --judge"),
        ({"judge": True, "record": False}, "leave --no-record"),
        ({"judge": True, "guidance": ("none", "none")}, "asked for twice"),
        ({"settings": replace(asked.settings, port="")}, "which port"),
    ):
        with pytest.raises(UsageError, match=message):
            ran(replace(asked, **change))


@pytest.mark.skipif(shutil.which("setsid") is None, reason="no setsid of util-linux")
@pytest.mark.parametrize(
    ("key", "number"), [(b"\x1a", signal.SIGTSTP), (b"\x1c", signal.SIGQUIT), (b"\x03", signal.SIGINT)]
)
def test_ctrl_z_and_the_like_in_its_own_terminal_stop_the_arm_and_suspend_nothing(
    arm, torque, tmp_path, until, key, number
):
    ours, theirs = pty.openpty()
    with _program(arm, tmp_path, stdin=theirs, before=("setsid", "--ctty", "--wait")) as program:
        _begin(program, ours)
        _moves(arm, program, until)
        os.write(ours, key)
        told, _ = program.communicate(timeout=60)
    os.close(ours)
    os.close(theirs)
    assert f"stopped by {number.name}" in told
    assert program.returncode == 128 + number
    assert torque() == OFF


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_no_torque_and_the_recording(arm, torque, tmp_path, until, number):
    with _program(arm, tmp_path) as program:
        _moves(arm, program, until)
        os.kill(program.pid, number)
        told, _ = program.communicate(timeout=60)
    assert program.returncode == 128 + number
    assert f"stopped by {number.name}" in told
    assert torque() == OFF
    _, episode = recorded(tmp_path)
    assert len(numbers(episode, "/joints")[1]) > 10


def test_space_in_the_terminal_stops_it(arm, torque, tmp_path, until):
    ours, theirs = pty.openpty()
    with _program(arm, tmp_path, stdin=theirs) as program:
        _begin(program, ours)
        _moves(arm, program, until)
        os.write(ours, b" ")
        told, _ = program.communicate(timeout=60)
    assert program.returncode == 0
    assert "stopped by Space" in told
    assert torque() == OFF
    assert recorded(tmp_path)
    os.close(ours)
    os.close(theirs)


def test_a_person_judges_by_keys_what_the_arm_did_and_it_goes_on_another_day(arm, torque, tmp_path):
    """Two layouts, two guidances: the first run is left at the third question, the second one begins with it."""
    judged = _judging(arm, tmp_path, "\nyn" + "\ny ")
    assert "1 of 4 episodes are judged" in judged
    assert not re.search(r"jiti|none", judged.replace("jiti rollout", "").replace(str(tmp_path), ""))
    recordings = [recorded_metadata(path) for path in (tmp_path / "judged").glob("*.mcap")]
    assert len(recordings) == 2
    assert not any("guidance" in about or "jiti" in about.values() for about in recordings)
    told = _judging(arm, tmp_path, "yy" + "\nyy" + "\nyn" + "\n")
    assert torque() == OFF
    assert "Judged by a person, 95% intervals by Wilson" in told
    rows = pq.read_table(tmp_path / "evaluation.parquet").to_pylist()
    assert [(row["success"], dict(row["itcs"])["so100/T5/shut-smoothly"]) for row in rows] == [
        (True, False),
        (True, True),
        (True, True),
        (True, False),
    ]
    assert sorted((row["layout"], row["guidance"]) for row in rows) == [
        (0, "jiti"),
        (0, "none"),
        (1, "jiti"),
        (1, "none"),
    ]
    labels = read_segments(Path(open_reader(tmp_path / "judged").labels_dir)).to_pylist()
    assert [(row["source"], row["reward"]) for row in labels] == [("human", r) for r in (0, 1, 1, 0)]


def _judging(arm, out: Path, keys: str) -> str:
    """What it says to a person who presses the keys, one at each prompt."""
    ours, theirs = pty.openpty()
    presses, said = iter(keys), []
    with _program(arm, out, "judge", stdin=theirs) as program:
        for line in program.stdout:
            said.append(line)
            if "[Space] stop" in line:
                os.write(ours, next(presses).replace("\n", "\r").encode())
        program.wait(timeout=60)
    os.close(ours)
    os.close(theirs)
    assert next(presses, None) is None, "".join(said)
    assert program.returncode == 0, "".join(said)
    return "".join(said)


def test_space_while_the_policy_is_loaded_ends_it_without_torque(arm, tmp_path):
    ours, theirs = pty.openpty()
    with _program(arm, tmp_path, stdin=theirs) as program:
        for line in program.stdout:
            if "Loading" in line:
                break
        os.write(ours, b" ")
        told, _ = program.communicate(timeout=60)
    os.close(ours)
    os.close(theirs)
    assert "stopped by Space" in told
    assert "[Enter]" not in told
    assert not list(tmp_path.rglob("*.mcap"))


def test_a_signal_to_all_its_processes_lets_the_virtual_arm_go_in_order(tmp_path):
    command = [sys.executable, "-m", "jiti", "record", "--robot", "so100", "--port", "virtual", "--leader", "virtual"]
    command += ["--task", "so100/T5", "--episodes", "1", "--out", str(tmp_path / "demos")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, env=environment, start_new_session=True, **pipes
    ) as program:
        for line in program.stdout:
            if line.startswith("Recording"):
                break
        os.killpg(program.pid, signal.SIGTERM)
        told, _ = program.communicate(timeout=60)
    assert program.returncode == 128 + signal.SIGTERM, told
    assert "stopped by SIGTERM" in told
    assert "is gone" not in told
    assert "did not say" not in told


def test_a_second_program_on_the_port_is_refused_and_the_first_goes_on(arm, torque, tmp_path, until):
    with _program(arm, tmp_path / "first") as first:
        _moves(arm, first, until)
        with _program(arm, tmp_path / "second") as second:
            told, _ = second.communicate(timeout=60)
        assert second.returncode == 1
        assert "End it first" in told or "End other programs" in told
        assert torque() == [1] * 6
        assert first.poll() is None
        first.terminate()
        first.communicate(timeout=60)
    assert torque() == OFF


@pytest.mark.slow
@pytest.mark.parametrize("guidance", ["none", "jiti"])
def test_a_minute_at_30_hz(asked, torque, guidance):
    """With SmolVLA's measured latencies: 112 ms for a chunk, 449 ms with all candidates, which a third asks for.

    How evenly the loop runs is measured by benchmarks/so100.py: on a machine that others use it is no property."""
    done, _ = ran(replace(asked, guidance=(guidance,), seconds=60.0), make_agent=robot_agents.smolvla)
    (episode,) = done.report.episodes
    assert done.problem is None
    assert episode.acting == 1800
    assert episode.held < 900
    assert episode.decisions > 30
    assert torque() == OFF


def _begin(program: subprocess.Popen, terminal: int) -> None:
    """Press Enter once it is asked for."""
    for line in program.stdout:
        if "[Enter] begin" in line:
            os.write(terminal, b"\r")
            return
    raise AssertionError("it never asked")


def _moves(arm, program: subprocess.Popen, until) -> None:
    """Wait until it does, or tell what the program said that ended before."""
    until(lambda: abs(arm.state().joints["shoulder_pan"]) > 0.2 or program.poll() is not None)
    assert program.poll() is None, program.communicate()[0]


def _program(
    arm, out: Path, *more: str, stdin: int = subprocess.DEVNULL, before: Sequence[str] = ()
) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.Popen(
        [*before, *robot_rollout.command(arm, out, *more)],
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
    )
