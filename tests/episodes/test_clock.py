"""The reference clock: frames, alignment, and clocks that jump."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jiti.episodes.clock import JUMP_NS, Clock, fixed_rate, unwrap, unwrap_together

SECOND = 10**9
rising = arrays(np.int64, st.integers(1, 60), elements=st.integers(0, 10**10)).map(np.sort)


def regular(count: int, rate_hz: float = 30.0, start_s: float = 100.0) -> np.ndarray:
    return int(start_s * SECOND) + np.rint(np.arange(count) * SECOND / rate_hz).astype(np.int64)


@given(rising)
def test_shown_times_strictly_increase_from_zero_and_stay_close(times: np.ndarray) -> None:
    shown = Clock("camera", times).display_ns
    assert shown[0] == 0
    assert (np.diff(shown) > 0).all()
    assert (shown >= times - times[0]).all()
    assert (shown - (times - times[0]) <= len(times)).all()


@given(rising, rising)
def test_hold_takes_the_latest_sample_at_or_before_each_frame(frames: np.ndarray, samples: np.ndarray) -> None:
    held = Clock("camera", frames).hold(samples)
    for frame_ns, index in zip(frames, held, strict=True):
        before = np.flatnonzero(samples <= frame_ns)
        assert index == (before[-1] if len(before) else -1)


@given(rising, rising, st.integers(0, 10**10))
def test_late_frames_are_those_without_a_recent_sample(frames: np.ndarray, samples: np.ndarray, tolerance: int) -> None:
    late = set(Clock("camera", frames).late_frames(samples, tolerance).tolist())
    for index, frame_ns in enumerate(frames):
        recent = ((samples <= frame_ns) & (frame_ns - samples <= tolerance)).any()
        assert (index in late) == (not recent)


@given(st.integers(0, 10**18), st.integers(0, 10 * SECOND), st.floats(1, 240))
def test_fixed_rate_covers_the_span(start: int, span: int, rate_hz: float) -> None:
    clock = fixed_rate(start, start + span, rate_hz)
    assert clock.frame_ns[0] == start
    assert start + span - SECOND / rate_hz - 1 <= clock.frame_ns[-1] <= start + span + 1


@given(rising)
def test_times_in_order_are_left_alone(times: np.ndarray) -> None:
    unwrapped, jumps = unwrap(times)
    assert (unwrapped == times).all()
    assert not len(jumps)


@given(st.integers(5, 200), st.data())
def test_small_disorder_is_left_to_a_sort(count: int, data: st.DataObject) -> None:
    shaken = regular(count) + data.draw(arrays(np.int64, count, elements=st.integers(0, JUMP_NS // 2)))
    unwrapped, jumps = unwrap(shaken)
    assert (unwrapped == shaken).all()
    assert not len(jumps)


@given(st.integers(20, 200), st.floats(0.1, 0.9), st.integers(JUMP_NS + SECOND, 10**15))
def test_a_clock_set_back_goes_on_without_gap_or_overlap(count: int, share: float, back: int) -> None:
    times = regular(count, start_s=10**7)
    at = min(max(5, int(count * share)), count - 6)
    broken = times.copy()
    broken[at:] -= back
    unwrapped, jumps = unwrap(broken)
    if len(jumps):  # else the stretches fit together in another order, which is no jump
        assert jumps.tolist() == [at]
        assert np.abs(np.diff(unwrapped) - SECOND / 30).max() <= 2
    else:
        assert (np.diff(np.sort(broken)) <= JUMP_NS).all()


def test_two_jumps() -> None:
    times = np.concatenate([regular(30, start_s=50), regular(30, start_s=20), regular(30, start_s=5)])
    unwrapped, jumps = unwrap(times)
    assert jumps.tolist() == [30, 60]
    assert np.abs(np.diff(unwrapped) - SECOND / 30).max() <= 2


def test_a_few_late_messages_are_no_jump() -> None:
    times = regular(60)
    late = np.insert(times, 40, times[10])
    unwrapped, jumps = unwrap(late)
    assert not len(jumps)
    assert (np.sort(unwrapped) == np.sort(late)).all()


def test_a_message_ahead_of_its_time_moves_no_other() -> None:
    times = regular(60)
    times[20] += 3600 * SECOND
    unwrapped, jumps = unwrap(times)
    assert jumps.tolist() == [21]
    assert unwrapped[20] == unwrapped[19]
    assert (np.delete(unwrapped, 20) == np.delete(times, 20)).all()


@pytest.mark.parametrize("parts", [(1, 0), (2, 0, 1), (3, 2, 1, 0)])
def test_stretches_recorded_out_of_order_are_no_jump(parts: tuple[int, ...]) -> None:
    times = regular(120)
    shuffled = np.concatenate([np.split(times, len(parts))[k] for k in parts])
    unwrapped, jumps = unwrap(shuffled)
    assert not len(jumps)
    assert (np.sort(unwrapped) == times).all()


def test_streams_stay_aligned_over_a_jump() -> None:
    camera, joints, slow = regular(90), regular(300, 100), regular(3, 1.0)
    when = camera[45] - 1
    true = {"camera": camera, "joints": joints, "slow": slow, "late": regular(60, 30, 101.6)}
    broken = {name: np.where(times > when, times - 77 * SECOND, times) for name, times in true.items()}
    unwrapped = unwrap_together(list(broken.values()), list(true.values()))
    shift = unwrapped[1][0] - true["joints"]
    assert np.abs(shift).max() <= SECOND / 100
    for (times, _), name in zip(unwrapped, true, strict=True):
        # All streams by the same amount: that by which the densest was misjudged, at most one of its periods.
        assert set((times - true[name]).tolist()) <= {0, int(shift[-1])}, name
