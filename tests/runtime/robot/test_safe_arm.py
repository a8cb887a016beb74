"""lerobot's real driver on the virtual arm: no move that no one asked for, and no torque that is left behind."""

import json
import math
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from threading import Thread
from time import monotonic, sleep

import pytest

from jiti.errors import RobotError
from jiti.runtime.robot.virtual import Faults, VirtualArm, registers

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("ignore")]
"""lerobot and what it imports warn of themselves."""
ON, OFF = [1] * 6, [0] * 6


@pytest.fixture(autouse=True)
def _no_questions(monkeypatch):
    monkeypatch.setattr("builtins.input", lambda prompt="": pytest.fail(f"someone asks: {prompt}"))


@pytest.fixture
def opened(settings):
    """Opens an arm with settings; `said` has what a person was told."""
    from jiti.runtime.robot.safe_arm import SafeArm

    said: list[str] = []

    def make(**changed) -> SafeArm:
        return SafeArm(replace(settings, **changed), say=said.append)

    make.said = said
    return make


def sweep(safe, steps: int, *, to: float = 20.0) -> None:
    """Move all joints to and fro, as a policy would; the first one by `to` degrees at most."""
    rest = dict(safe.goal)
    for step in range(steps):
        safe.observe()
        away = {name: (to if name == "shoulder_pan" else 20) * math.sin(step / 15) for name in rest}
        safe.send(
            {name: min(max(rest[name] + away[name], safe.limits.low[name]), safe.limits.high[name]) for name in rest}
        )
        sleep(1 / 30)


def used(opened, act, **changed) -> None:
    """An arm is opened and engaged, something is done with it, and it is closed."""
    with opened(**changed) as safe:
        safe.engage()
        act(safe)


def still(arm: VirtualArm) -> bool:
    """Whether nothing moves for a while."""
    before = arm.state().joints
    sleep(0.3)
    return all(abs(angle - before[name]) < 0.02 for name, angle in arm.state().joints.items())


@pytest.fixture
def comes_to_rest(arm, until):
    """Waits for an arm without torque to have sunk."""
    return lambda: until(lambda: still(arm))


def spoil(arm: VirtualArm, faults: Faults, *, after_s: float = 0.5) -> Thread:
    """In the middle of a motion."""

    def strike() -> None:
        sleep(after_s)
        arm.faults = faults

    thread = Thread(target=strike)
    thread.start()
    return thread


def test_it_is_at_rest_until_it_is_engaged_and_after_it_is_released(arm, opened, torque, comes_to_rest):
    with opened() as safe:
        assert torque() == OFF
        assert safe.observe()["shoulder_lift.pos"] == pytest.approx(-100, abs=1)
        safe.engage()
        assert torque() == ON
        sweep(safe, 45)
        safe.release()
        assert torque() == OFF
        safe.engage()
        assert torque() == ON
    assert torque() == OFF
    comes_to_rest()


def test_a_stale_goal_moves_nothing(arm, opened, until):
    """A raw goal far from where the arm stands, as one that fell while it had no torque has."""
    with opened() as safe:
        for name in safe.joints:
            safe.robot.bus.write("Goal_Position", name, 2047 + 600, normalize=False)
    before = arm.state().joints
    with opened() as safe:
        safe.engage()
        for _ in range(20):
            safe.observe()
            safe.hold()
            assert all(abs(angle - before[name]) < 0.05 for name, angle in arm.state().joints.items())
            sleep(1 / 30)


def test_configuring_does_not_turn_the_torque_on(arm, opened, torque):
    with opened() as safe:
        assert torque() == OFF
        memories = list(arm.memories().values())
        assert {(m[registers.P_COEFFICIENT], m[registers.D_COEFFICIENT]) for m in memories} == {(16, 32)}
        safe.robot.bus.enable_torque()  # lerobot's own is itself again
        assert torque() == ON
        safe.robot.bus.disable_torque()


def test_an_action_that_is_no_place_is_not_sent(arm, opened, torque, comes_to_rest):
    goals: list[list[int]] = []

    def act(safe) -> None:
        goals.append([memory[registers.GOAL_POSITION] for memory in arm.memories().values()])
        try:
            safe.send({**safe.goal, "elbow_flex": math.nan})
        finally:
            goals.append([memory[registers.GOAL_POSITION] for memory in arm.memories().values()])

    with pytest.raises(RobotError, match="has nan for elbow_flex"):
        used(opened, act)
    assert goals[0] == goals[1]
    assert torque() == OFF
    comes_to_rest()


def test_a_goal_far_away_is_reached_in_steps(arm, opened):
    with opened() as safe:
        safe.engage()
        first = safe.goal["shoulder_pan"]
        checked = safe.send({**safe.goal, "shoulder_pan": 720.0})
        assert checked.goal["shoulder_pan"] == first + 5
        assert checked.clamped == ("shoulder_pan",)


def test_a_mute_servo_is_named_and_the_others_let_go(arm, opened, torque, until, comes_to_rest):
    with pytest.raises(RobotError, match=r"servo 3 \(elbow_flex\) does not answer. Check the cable"):
        used(opened, lambda safe: sweep_and(arm, safe, Faults(mute=frozenset({3}))))
    # The mute one only does not answer: it heard that its torque is off.
    assert torque() == OFF
    comes_to_rest()


def test_a_servo_that_does_not_confirm_its_release_is_told(arm, opened, torque):
    with opened() as safe:
        safe.engage()
        arm.faults = Faults(mute=frozenset({3, 5}))
        with pytest.raises(
            RobotError, match=r"servo 3 \(elbow_flex\), servo 5 \(wrist_roll\) did not say that its torque"
        ):
            safe.release()
        assert safe.engaged, "it is to be tried again"
        with pytest.raises(RobotError, match=r"^why servo 3 .* switch its power off; then check the cable[^.]*\.$"):
            safe.stop(ValueError("why"))
        arm.faults = Faults()
    assert not safe.engaged
    assert not any("Take hold" in said for said in opened.said), "it had been let go"
    assert torque() == OFF


def test_a_camera_that_gives_no_picture_is_named(opened):
    class Dead:
        def read_latest(self):
            raise TimeoutError("the latest is too old.")

    with opened() as safe:
        safe.robot.cameras["front"] = Dead()
        with pytest.raises(RobotError, match=r"camera 'front' gives no picture: the latest is too old\. Check"):
            safe.observe()


def test_a_corrupt_line_is_borne(arm, opened, torque):
    with opened() as safe:
        safe.engage()
        arm.faults = Faults(corrupt=0.05)
        sweep(safe, 150)
        assert safe.misread > 0
    assert torque() == OFF


def test_signals_in_the_middle_of_an_exchange_are_no_cable_that_is_out(arm, opened):
    heard = []
    before = signal.signal(signal.SIGALRM, lambda *_: heard.append(monotonic()))
    try:
        with opened() as safe:
            safe.engage()
            signal.setitimer(signal.ITIMER_REAL, 0.0005, 0.0005)
            end = monotonic() + 4
            while monotonic() < end:
                safe.observe()
                safe.hold()
            signal.setitimer(signal.ITIMER_REAL, 0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert len(heard) > 1000


def test_a_line_that_stays_corrupt_is_given_up(arm, opened, torque):
    with pytest.raises(RobotError, match=r"does not answer|were damaged|did not say"):
        used(opened, lambda safe: sweep_and(arm, safe, Faults(corrupt=1.0)))
    assert torque() == OFF


def test_an_unplugged_arm_is_let_go_when_it_is_plugged_in_again(arm, opened, torque, comes_to_rest):
    def act(safe) -> None:
        spoil(arm, Faults(unplugged=True))
        try:
            sweep(safe, 90)
        finally:
            assert torque() == ON, "nobody can tell them"
            spoil(arm, Faults())

    with pytest.raises(RobotError, match="is gone in the middle of work: plug"):
        used(opened, act)
    assert torque() == OFF
    assert any("Plug the cable in again" in said for said in opened.said)
    comes_to_rest()


def test_an_arm_that_stays_unplugged_is_told(arm, opened):
    with pytest.raises(RobotError, match=r"is gone .* did not come back: all servos may still have torque"):
        used(opened, lambda safe: sweep_and(arm, safe, Faults(unplugged=True)), replug_s=0.5)


def test_a_joint_that_is_jammed_is_named(arm, opened, torque, comes_to_rest):
    def act(safe) -> None:
        for _ in range(200):
            safe.observe()
            safe.send({**safe.goal, "shoulder_pan": 60.0})
            sleep(1 / 30)

    arm.faults = Faults(jam=frozenset({1}))
    with pytest.raises(RobotError, match=r"servo 1 \(shoulder_pan\) stays \d+ degrees from where it was sent"):
        used(opened, act)
    assert torque() == OFF
    comes_to_rest()


def test_an_overloaded_servo_is_named_and_let_go(arm, opened, torque):
    with pytest.raises(RobotError, match=r"servo 2 \(shoulder_lift\) reports an overload error. Free it"):
        used(opened, lambda safe: sweep_and(arm, safe, Faults(overload=frozenset({2}))))
    assert torque() == OFF


def test_a_gripper_that_presses_for_long_is_counted_and_goes_on(arm, opened, torque):
    with opened() as safe:
        safe.engage()
        arm.faults = Faults(overload=frozenset({6}))
        sweep(safe, 30)
        assert safe.overloads["gripper"] > 0
    assert torque() == OFF


def test_without_commands_it_is_held_and_then_let_go(arm, opened, torque, until):
    with opened(hold_after_s=0.4, release_after_s=1.0) as safe:
        safe.engage()
        for _ in range(10):
            safe.send({**safe.goal, "shoulder_pan": 60.0, "elbow_flex": 0.0})
            sleep(1 / 30)
        until(lambda: any("is held" in said for said in opened.said))
        assert torque() == ON
        assert still(arm)
        until(lambda: torque() == OFF)
        with pytest.raises(RobotError, match=r"let go, because no command came for 1\.4 s"):
            safe.hold()


def test_a_terminal_that_blocks_does_not_keep_the_torque_on(settings, torque, until):
    from jiti.runtime.robot.safe_arm import SafeArm

    with SafeArm(replace(settings, hold_after_s=0.4), say=lambda _: sleep(30)) as safe:
        safe.engage()
        until(lambda: torque() == OFF)


def test_a_terminal_that_is_gone_does_not_keep_the_torque_on(settings, torque):
    from jiti.runtime.robot.safe_arm import SafeArm

    def say(_said: str) -> None:
        raise BrokenPipeError

    with SafeArm(settings, say=say) as safe:
        safe.engage()
    assert torque() == OFF


def test_a_dry_run_writes_nothing(arm, settings, torque):
    from jiti.runtime.robot.safe_arm import SafeArm

    before = {number: memory.read(0, 56) for number, memory in arm.memories().items()}
    with SafeArm(settings, dry=True, say=lambda _: None) as safe:
        safe.engage()
        sweep(safe, 10)
        safe.hold()
        assert torque() == OFF
    assert {number: memory.read(0, 56) for number, memory in arm.memories().items()} == before


def test_another_process_is_kept_out(arm, opened, torque, settings):
    code = (
        "import sys\nfrom jiti.runtime.robot.port_lock import PortLock\nfrom jiti.errors import RobotError\n"
        "try:\n    PortLock(sys.argv[1])\nexcept RobotError as error:\n    print(error)"
    )
    with opened() as safe:
        safe.engage()
        sweep(safe, 5)
        done = subprocess.run([sys.executable, "-c", code, settings.port], capture_output=True, text=True, check=True)
        assert "End it first" in done.stdout or "End other programs" in done.stdout
        sweep(safe, 5)
        with pytest.raises(RobotError, match=r"another program drives the arm|cannot be opened"), opened():
            pass
        assert torque() == ON, "the one that has it goes on"
    with opened():
        pass


def test_a_port_that_is_not_there(opened):
    with pytest.raises(RobotError, match=r"there is no /dev/ttyNONE. Plug the arm in"):
        used(lambda: opened(port="/dev/ttyNONE"), sweep)


def test_a_servo_that_is_mute_from_the_beginning_is_named(arm, opened, torque):
    arm.faults = Faults(mute=frozenset({4}))
    with pytest.raises(RobotError, match=r"servo 4 \(wrist_flex\) does not answer at"), opened():
        pass
    assert torque() == OFF


def test_a_calibration_of_another_arm_is_told_joint_by_joint(arm, opened, torque):
    path = Path(arm.calibration_dir) / f"{arm.id}.json"
    content = json.loads(path.read_text())
    content["elbow_flex"]["homing_offset"] += 7
    content["gripper"]["range_max"] -= 1
    path.write_text(json.dumps(content))
    with pytest.raises(RobotError, match=r"elbow_flex has homing_offset .*; gripper has range_max .*lerobot-calibrate"):
        used(opened, sweep)
    path.unlink()
    with pytest.raises(RobotError, match=r"has no calibration at .*virtual.json. Make it with `lerobot-calibrate"):
        used(opened, sweep)
    assert torque() == OFF


def test_an_error_of_its_user_lets_it_go(arm, opened, torque):
    with pytest.raises(ZeroDivisionError):
        used(opened, lambda safe: sweep(safe, 10 // 0))
    assert torque() == OFF
    assert any("Take hold of the arm" in said for said in opened.said)


def sweep_and(arm: VirtualArm, safe, faults: Faults) -> None:
    strike = spoil(arm, faults)
    try:
        sweep(safe, 150)
    finally:
        strike.join()
