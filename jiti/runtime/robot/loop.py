"""An arm's control loop: observe, take what was decided meanwhile, send what is due, at a fixed rate."""

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter, sleep, time_ns

import numpy as np

from jiti.errors import RobotError
from jiti.runtime.candidates.observation import Observation
from jiti.runtime.robot.course import Course
from jiti.runtime.robot.inference import Facts, Inference
from jiti.runtime.robot.limits import GRIPPER, Joints
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.stops import Stops
from jiti.runtime.robot.tick import Arrived, Tick, Watcher, observation_of

RETURN_STEP = 2.0
"""Degrees a step on the way back to rest: 60 degrees a second. Our choice."""
NEAR = 3.0
"""Degrees from its rest at which an arm has come back; gravity keeps it from getting nearer. Our choice."""
RETURN_S = 10.0
SWITCH_S = 0.0005
"""Python's own is 5 ms, and reading six servos hands the interpreter over more than a hundred times. With the virtual
cameras rendering in the same process, this took 4 ms off the period's 99th percentile."""


class Pace:
    """Steps of a fixed period. One that comes too late is not made up for."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = perf_counter()

    def wait(self) -> None:
        self._due_s = max(self._due_s + self._period_s, perf_counter())
        sleep(self._due_s - perf_counter() if self._due_s > perf_counter() else 0)


@contextmanager
def prompt() -> Iterator[None]:
    """Threads hand the interpreter over after `SWITCH_S`: the loop does not wait for one that compresses pictures."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def run_episode(
    arm: SafeArm, inference: Inference, facts: Facts, stops: Stops, watchers: Sequence[Watcher], *, seconds: float
) -> str:
    """Act on the policy's decisions from the first one on, until `time` is over or `Enter` is pressed: which of them it
    was. The arm is engaged.

    Raises Stopped when the arm is to stop, RobotError when it cannot go on, and what policy and critic raise.
    """
    settings, course = arm.settings, Course(facts.execute)
    cameras = tuple(arm.robot.cameras)
    before: deque[Observation] = deque(maxlen=facts.history)
    pace, tick, last_s = Pace(settings.period_s), 0, float("nan")
    steps = round(seconds * settings.fps)
    acting = 0
    stops.look()  # an Enter of before this episode does not end it
    while acting < steps:
        if stops.look():
            return "Enter"
        began_s, began_ns = perf_counter(), time_ns()
        seen = arm.observe()
        observed_s = perf_counter()
        if seen is not None:
            before.append(observation_of(seen, arm.joints, cameras))
            if (answer := inference.answer()) is not None:
                dropped = course.take(answer.chunk)
                for watcher in watchers:
                    watcher.arrived(Arrived(answer, tick, dropped))
            if inference.asked_s is None and course.wants():
                course.observe()
                inference.ask(before, tick)
        _check_stalled(inference, settings.stall_s)
        action = course.next() if seen is not None else None
        sending_s = perf_counter()
        asked, clamped = None, ()
        if action is None:
            arm.hold()
        else:
            asked = _by_joint(action, arm.joints)
            clamped = arm.send(asked).clamped
        sent_s = perf_counter()
        done = Tick(
            tick,
            began_ns,
            seen,
            asked,
            arm.goal,
            clamped,
            course.begun,
            began_s - last_s,
            observed_s - began_s,
            sent_s - sending_s,
            sent_s - began_s,
        )
        for watcher in watchers:
            watcher.ticked(done)
        acting += course.begun
        tick, last_s = tick + 1, began_s
        pace.wait()
    return "time"


def go_back(arm: SafeArm, stops: Stops, rest: Joints) -> None:
    """Move slowly to where the arm lay when it had no torque, so that it does not fall when it has none again.

    Raises RobotError where it does not get there, for the arm to be held until a person has hold of it."""
    pace = Pace(arm.settings.period_s)
    for _ in range(round(RETURN_S * arm.settings.fps)):
        stops.look()
        seen = arm.observe()
        if seen is not None and all(abs(seen[f"{name}.pos"] - rest[name]) < NEAR for name in rest if name != GRIPPER):
            return
        arm.send(nearer(arm.goal, rest))
        pace.wait()
    raise RobotError(
        f"the arm did not get back to where it lay in {RETURN_S:g} s, and was let go where it was. Free its way, and "
        "lay it down by hand."
    )


def nearer(goal: Joints, place: Joints) -> dict[str, float]:
    """A slow step from a goal to a place, on the straight way: the joints arrive together. Where each went as fast as
    it may, the fingers came down on the table before the arm was folded."""
    left = {name: place[name] - goal[name] for name in place}
    share = RETURN_STEP / max(RETURN_STEP, *map(abs, left.values()))
    return {name: goal[name] + share * left[name] for name in place}


def _by_joint(action: np.ndarray, joints: tuple[str, ...]) -> dict[str, float]:
    if len(action) != len(joints):
        raise RobotError(
            f"the policy's actions have {len(action)} numbers, and the arm {len(joints)} joints ({', '.join(joints)}). "
            "Pass a policy that was trained on this arm."
        )
    return {name: float(value) for name, value in zip(joints, action, strict=True)}


def _check_stalled(inference: Inference, stall_s: float) -> None:
    if inference.asked_s is not None and perf_counter() - inference.asked_s > stall_s:
        raise RobotError(
            f"policy and critic have not decided anything for {stall_s:g} s. Use --device cuda or a smaller policy, or "
            "raise `stall_s` in the file of --robot-config."
        )
