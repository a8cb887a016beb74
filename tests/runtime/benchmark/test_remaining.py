"""The share that is done and the time that is left follow from what the run itself took."""

import pytest

from jiti.runtime.benchmark import remaining
from jiti.runtime.benchmark.remaining import CORE_S, Remaining, duration


def test_what_the_run_took_corrects_what_was_expected(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(remaining, "monotonic", lambda: now[0])
    told: list[tuple[float, str]] = []
    clock = Remaining({"record": 100, "rollouts": 300}, 2, lambda share, what: told.append((share, what)))
    record, rollouts = 100 * CORE_S["record"] / 2, 300 * CORE_S["rollouts"] / 2
    assert clock.left_s() == pytest.approx(record + rollouts)
    tell = clock.begin("record")
    now[0] = record  # half of the recordings took what all were to take
    tell(0.5, "recording")
    assert clock.left_s() == pytest.approx(record + 2 * rollouts)
    assert told == [
        (pytest.approx(0.5 * record / (record + rollouts)), f"recording; about {duration(clock.left_s())} left")
    ]
    tell(1.0, "recorded")
    tell = clock.begin("rollouts")
    tell(1.0, "played")
    assert clock.share() == 1.0
    assert clock.left_s() == 0.0


def test_nothing_to_do_is_done():
    clock = Remaining({}, 2, lambda _share, _what: None)
    assert (clock.share(), clock.left_s()) == (1.0, 0.0)


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0 s"), (89, "89 s"), (100, "2 min"), (7500, "2 h 5 min")])
def test_durations_are_told_as_people_do(seconds, text):
    assert duration(seconds) == text
