"""The frames that a model is shown: the ends, what happened, and the rest evenly; never more than asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.events import Event
from jiti.annotate.vlm.sampling import (
    AROUND_S,
    MARGIN_S,
    OVERVIEW_FRAMES,
    SEGMENT_FRAMES,
    overview_frames,
    segment_frames,
)
from jiti.episodes.clock import Clock


def clock_of(count: int, rate_hz: float = 30.0) -> Clock:
    return Clock("camera", 10**18 + np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64))


def event(frame: int, sharpness: float = 0.5) -> Event:
    return Event(frame, "gripper_close", "/gripper", sharpness)


@st.composite
def clocks(draw: st.DrawFn) -> Clock:
    """Even ones, and those of a recorder that stalls and stamps several pictures alike."""
    count = draw(st.integers(1, 400))
    if draw(st.booleans()):
        return clock_of(count, draw(st.sampled_from([0.5, 10, 20, 30, 240])))
    steps = draw(st.lists(st.sampled_from([0, 1, 10**6, 10**8, 10**10]), min_size=count - 1, max_size=count - 1))
    return Clock("camera", np.cumsum([10**18, *steps]).astype(np.int64))


@st.composite
def happenings(draw: st.DrawFn) -> tuple[Clock, list[Event]]:
    clock = draw(clocks())
    frames = st.integers(0, clock.frame_count - 1)
    return clock, draw(st.lists(st.builds(event, frames, st.floats(0, 1)), max_size=12))


@given(happenings(), st.integers(2, 60))
@settings(max_examples=80, deadline=None)
def test_an_overview_has_the_ends_in_order_and_as_many_frames_as_there_can_be(happened, most):
    clock, events = happened
    frames = overview_frames(clock, events, most)
    assert frames == sorted(set(frames))
    assert (frames[0], frames[-1]) == (0, clock.frame_count - 1)
    assert len(frames) == min(most, clock.frame_count)
    assert all(type(frame) is int for frame in frames)


@given(st.integers(0, OVERVIEW_FRAMES), st.lists(st.integers(0, 23), max_size=3))
@settings(max_examples=40)
def test_a_short_episode_is_shown_whole(count, at):
    events = [event(frame) for frame in at if frame < count]
    assert overview_frames(clock_of(count), events) == list(range(count))


@given(st.integers(25, 400), st.lists(st.integers(0, 399), min_size=1, max_size=3), st.sampled_from([10.0, 20.0, 30.0]))
@settings(max_examples=80)
def test_events_are_shown_with_what_was_before_and_after(count, at, rate_hz):
    at = [frame % count for frame in at]
    frames = overview_frames(clock_of(count, rate_hz), [event(frame) for frame in at])
    around = round(AROUND_S * rate_hz)
    for frame in at:
        assert {max(0, frame - around), frame, min(count - 1, frame + around)} <= set(frames)


def test_the_sharpest_events_come_first():
    """Of 24 frames 12 may be for events: with the ends, three times three."""
    events = [event(20 * k, sharpness=k / 20) for k in range(1, 15)]
    frames = overview_frames(clock_of(301, 20), events)
    whole = [k for k in range(1, 15) if {20 * k - 5, 20 * k, 20 * k + 5} <= set(frames)]
    assert whole == [12, 13, 14]


def test_without_events_no_gap_is_more_than_twice_another():
    for count in (25, 30, 47, 100, 1000):
        gaps = np.diff(overview_frames(clock_of(count), []))
        assert gaps.max() <= 2 * gaps.min() + 1


@given(happenings())
@settings(max_examples=80, deadline=None)
def test_what_is_between_events_is_seen_as_well(happened):
    """Half of the frames halve the widest gaps, so that none is longer than an eighth of a long episode."""
    clock, events = happened
    gaps = np.diff([0, *overview_frames(clock, events)])
    assert gaps.max() <= max(1, -(-clock.frame_count // 8))


@given(clocks(), st.data())
@settings(max_examples=80, deadline=None)
def test_a_segment_is_shown_with_both_its_ends_or_nearly_and_the_episodes(clock, data):
    last = clock.frame_count - 1
    start, end = sorted(data.draw(st.tuples(st.integers(0, last), st.integers(0, last))))
    most = data.draw(st.integers(2, 20))
    frames = segment_frames(clock, start, end, most)
    assert frames == sorted(set(frames))
    assert (frames[0], frames[-1]) == (0, last)
    assert len(frames) <= most + 2
    margin = round(MARGIN_S * clock.rate_hz)
    low, high = max(0, start - margin), min(last, end + margin)
    assert {low, high} <= set(frames)
    inner = [frame for frame in frames if low <= frame <= high]
    assert len(inner) == min(most, high - low + 1)
    assert np.ptp(np.diff(inner)) <= 1 if len(inner) > 2 else True
    assert set(frames) - set(inner) <= {0, last}


def test_a_segment_by_hand():
    assert segment_frames(clock_of(200, 20), 100, 124) == [0, 94, 98, 102, 106, 110, 114, 118, 122, 126, 130, 199]
    assert segment_frames(clock_of(200, 20), 0, 24) == [0, 3, 7, 10, 13, 17, 20, 23, 27, 30, 199]
    assert segment_frames(clock_of(5, 20), 1, 2) == [0, 1, 2, 3, 4]
    assert segment_frames(clock_of(1), 0, 0) == [0]


@pytest.mark.parametrize(("count", "start", "end"), [(80, 30, 54), (1000, 0, 999), (26, 0, 24)])
def test_a_segment_fits_one_sheet(count, start, end):
    assert len(segment_frames(clock_of(count), start, end)) <= SEGMENT_FRAMES + 2 == 12
