"""Chunks overlap in time, action by action, whatever a decision takes."""

import numpy as np
import pytest

from jiti.runtime.robot.course import Course


def played(execute: int, chunk: int, latency: int, steps: int) -> tuple[list[int | None], int]:
    """What was executed at each step from the first chunk on (numbers of the actions that a perfect policy counts),
    and how often it was held; a decision takes `latency` steps."""
    course, done, pending = Course(execute), [], None
    for step in range(steps):
        if pending is not None and step - pending[0] >= latency:
            # The action that is due after p others is p itself.
            course.take(np.arange(pending[1], pending[1] + chunk)[:, None])
            pending = None
        if pending is None and course.wants():
            course.observe()
            pending = step, course.position
        action = course.next()
        if course.begun:
            done.append(None if action is None else int(action[0]))
    return done, done.count(None)


@pytest.mark.parametrize(("execute", "chunk"), [(25, 50), (10, 20), (5, 50), (1, 2)])
def test_it_never_waits_while_a_decision_takes_no_longer_than_its_actions(execute, chunk):
    for latency in range(execute + 1):
        done, held = played(execute, chunk, latency, 400)
        assert held == 0, latency
        assert done == list(range(len(done)))


@pytest.mark.parametrize("latency", [11, 15, 19, 20, 30, 100])
def test_when_it_is_late_it_is_held_and_goes_on_where_it_was(latency):
    done, held = played(10, 20, latency, 2000)
    assert [action for action in done if action is not None] == list(range(len(done) - held))
    assert (held > 0) == (2 * latency > 20)


def test_what_was_executed_meanwhile_is_over_and_no_more():
    course = Course(2)
    course.observe()
    assert course.take(np.arange(4)[:, None]) == 0
    assert [course.next() for _ in range(3)] == [0, 1, 2]
    course.observe()
    course.next()
    assert course.next() is None
    assert course.next() is None
    assert course.take(np.arange(3, 9)[:, None]) == 1
    assert course.next() == 4
