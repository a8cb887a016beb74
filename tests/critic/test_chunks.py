"""Chunks are cut, rewarded and masked as a hand computation says; their order depends on nothing but the step."""

import numpy as np
import pytest

from jiti.critic.chunks import ActionRange, BatchOrder, action_range, cut_chunks, reaching_frames
from jiti.critic.dataset import read_elegant
from tests.critic.elegant import Recorded, write_elegant


@pytest.fixture
def data(tmp_path):
    def episode(length, first):
        frames = np.arange(length, dtype=float)
        reward = (frames % 2 == 0).astype(float)
        return Recorded(frames[:, None], (first + frames)[:, None], reward, np.ones(length, bool))

    return read_elegant(write_elegant(tmp_path / "d", [episode(5, 0), episode(4, 100)], gamma=0.5))


def test_a_chunk_inside_an_episode(data):
    limits = ActionRange(np.array([0.0]), np.array([200.0]))
    cut = cut_chunks(data, np.array([1]), chunk=3, offset=2, gamma=0.5, limits=limits)
    np.testing.assert_allclose(cut.action[0, :, 0], [-0.99, -0.98, -0.97], atol=1e-6)
    assert cut.mask.all()
    assert cut.reward[0] == 0 + 0.5 * 1
    assert cut.discount[0] == 0.25
    assert cut.next_frame[0] == 3
    assert cut.next_mask[0].tolist() == [True, True, False]
    assert cut.mc_return[0] == 0 + 0.5 * (1 + 0.5 * (0 + 0.5 * 1))


def test_a_chunk_that_the_episodes_end_cuts(data):
    limits = ActionRange(np.array([0.0]), np.array([200.0]))
    cut = cut_chunks(data, np.array([3, 4, 8]), chunk=3, offset=2, gamma=0.5, limits=limits)
    assert cut.mask.tolist() == [[True, True, False], [True, False, False], [True, False, False]]
    assert not cut.action[~cut.mask].any()
    assert cut.reward.tolist() == [0 + 0.5 * 1, 1, 0]
    assert cut.discount.tolist() == [0, 0, 0]


def test_rewards_and_next_values_add_up_to_the_return(data):
    limits = action_range(data, np.arange(2))
    cut = cut_chunks(data, np.arange(data.frames), chunk=3, offset=2, gamma=0.5, limits=limits)
    np.testing.assert_allclose(cut.reward + cut.discount * data.mc_return[cut.next_frame], cut.mc_return, atol=1e-6)


def test_actions_of_the_range_become_minus_one_to_one_and_constants_zero():
    limits = ActionRange(np.array([-2.0, 3.0]), np.array([6.0, 3.0]))
    unit = limits.to_unit(np.array([[-2.0, 3.0], [6.0, 3.0], [2.0, 3.0], [50.0, 3.0]]))
    np.testing.assert_allclose(unit, [[-0.999, 0], [0.999, 0], [0, 0], [0.999, 0]], atol=1e-6)


def test_every_pass_has_every_frame_once_and_a_step_does_not_depend_on_those_before():
    frames = np.arange(100, 110)
    order = BatchOrder(frames, frames[:0], 4, 0.0, seed=3)
    steps = np.concatenate([order.step(n) for n in range(5)])
    assert sorted(steps[:10]) == sorted(steps[10:]) == frames.tolist()
    assert steps[:10].tolist() != steps[10:].tolist()
    assert BatchOrder(frames, frames[:0], 4, 0.0, seed=3).step(3).tolist() == steps[12:16].tolist()


def test_a_share_of_each_step_reaches_into_decided_segments():
    frames, reaching = np.arange(100, 110), np.array([103, 104, 105])
    order = BatchOrder(frames, reaching, 4, 0.5, seed=3)
    steps = np.array([order.step(n) for n in range(15)])
    assert sorted(steps[:5, :2].ravel()) == frames.tolist()
    assert sorted(steps[:3, 2:].ravel()) == sorted([*reaching] * 2)
    assert BatchOrder(frames, reaching, 4, 0.5, seed=3).step(9).tolist() == steps[9].tolist()


def test_frames_reach_into_a_decided_segment_of_their_own_episode(tmp_path):
    annotated = np.zeros(6, bool)
    annotated[[0, 4]] = True
    episode = Recorded(np.zeros((6, 1)), np.zeros((6, 1)), annotated.astype(float), annotated)
    data = read_elegant(write_elegant(tmp_path / "d", [episode, episode], gamma=0.5))
    assert reaching_frames(data, np.arange(12), 3).tolist() == [0, 2, 3, 4, 6, 8, 9, 10]
