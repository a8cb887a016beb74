"""The frames of a time that a model named: those that were shown then, and a window's length at least."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES
from jiti.annotate.vlm.answers import shown_time
from jiti.annotate.window import SHOWN_S, frames_between
from jiti.episodes.clock import Clock

RATES_HZ = [10.0, 20.0, 29.97, 30.0, 50.0, 100.0]


def clock_of(count: int, rate_hz: float = 20.0) -> Clock:
    return Clock("camera", 1_735_689_600_000_000_000 + np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64))


@st.composite
def clocks(draw: st.DrawFn) -> Clock:
    """Even ones, and those of a recorder that stalls and stamps several pictures alike."""
    count = draw(st.integers(1, 200))
    if draw(st.booleans()):
        return clock_of(count, draw(st.sampled_from(RATES_HZ)))
    steps = draw(st.lists(st.sampled_from([0, 10**7, 5 * 10**7, 10**9]), min_size=count - 1, max_size=count - 1))
    return Clock("camera", np.cumsum([10**18, *steps]).astype(np.int64))


def times_s(clock: Clock) -> np.ndarray:
    return (clock.frame_ns - clock.frame_ns[0]) / 1e9


@given(clocks(), st.tuples(st.floats(0, 250), st.floats(0, 250)).map(sorted))
@settings(max_examples=150, deadline=None)
def test_a_window_is_in_the_episode_long_enough_and_has_all_frames_of_its_time(clock, span):
    start, end = frames_between(clock, *span)
    assert 0 <= start <= end < clock.frame_count
    assert end - start + 1 >= min(DEFAULT_WINDOW_FRAMES, clock.frame_count)
    inside = np.flatnonzero((times_s(clock) >= span[0]) & (times_s(clock) <= span[1]))
    if len(inside):
        assert start <= inside[0]
        assert inside[-1] <= end
        # A frame that is shown with the same two digits belongs to it.
        near = (times_s(clock) >= span[0] - SHOWN_S) & (times_s(clock) <= span[1] + SHOWN_S)
        assert end - start + 1 == max(near.sum(), min(DEFAULT_WINDOW_FRAMES, clock.frame_count))


@given(st.sampled_from(RATES_HZ), st.integers(DEFAULT_WINDOW_FRAMES, 300), st.data())
@settings(max_examples=80, deadline=None)
def test_the_times_of_two_frames_lead_back_to_them(rate_hz, count, data):
    clock = clock_of(count, rate_hz)
    start = data.draw(st.integers(0, count - DEFAULT_WINDOW_FRAMES))
    end = data.draw(st.integers(start + DEFAULT_WINDOW_FRAMES - 1, count - 1))
    assert frames_between(clock, times_s(clock)[start], times_s(clock)[end]) == (start, end)


@given(st.integers(DEFAULT_WINDOW_FRAMES, 300), st.data())
@settings(max_examples=80, deadline=None)
def test_a_short_time_lies_in_the_middle_of_its_window(count, data):
    clock = clock_of(count)
    first = data.draw(st.integers(0, count - 1))
    last = data.draw(st.integers(first, min(count - 1, first + DEFAULT_WINDOW_FRAMES - 1)))
    start, end = frames_between(clock, first / 20, last / 20)
    assert end - start + 1 == DEFAULT_WINDOW_FRAMES
    before, after = first - start, end - last
    assert 0 <= after - before <= 1 or (start == 0 and before < after) or (end == count - 1 and after < before)


def test_windows_by_hand():
    clock = clock_of(100)  # frames at 0.00, 0.05, ... 4.95 s
    assert frames_between(clock, 1.0, 3.0) == (20, 60)
    assert frames_between(clock, 1.01, 2.99) == (21, 59)
    assert frames_between(clock, 2.0, 2.0) == (28, 52)
    assert frames_between(clock, 0.0, 0.0) == (0, 24)
    assert frames_between(clock, 4.95, 4.95) == (75, 99)
    assert frames_between(clock, 90.0, 99.0) == (75, 99)
    assert frames_between(clock_of(10), 0.1, 0.2) == (0, 9)
    assert frames_between(clock_of(1), 0.0, 5.0) == (0, 0)


def test_frames_of_one_time_belong_together():
    clock = Clock("camera", 10**18 + np.repeat(np.arange(30), 3) * 50_000_000)
    assert frames_between(clock, 0.5, 1.0) == (30, 62)


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 50.0, 100.0])
def test_times_that_are_shown_exactly_lead_back_to_their_frames(rate_hz):
    clock = clock_of(200, rate_hz)
    for start in range(0, 170):
        span = [float(shown_time(times_s(clock)[frame])) for frame in (start, start + 29)]
        assert frames_between(clock, *span) == (start, start + 29)


@pytest.mark.parametrize("rate_hz", [15.0, 29.97, 30.0, 60.0])
def test_times_that_are_shown_rounded_lead_back_to_their_frames(rate_hz):
    clock = clock_of(200, rate_hz)
    for start in range(0, 170):
        span = [float(shown_time(times_s(clock)[frame])) for frame in (start, start + 29)]
        assert frames_between(clock, *span) == (start, start + 29)
