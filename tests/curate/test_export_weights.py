"""Weights mean what lerobot's RA-BC takes them for: what a chunk's progress grows by."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.curate.export.weights import value_progress
from jiti.curate.returns import mc_returns

REWARDS = st.lists(st.integers(0, 1), min_size=2, max_size=60).map(lambda found: np.array(found, np.float64))


@given(REWARDS, st.floats(0.5, 1.0))
def test_where_all_goes_as_expected_it_never_falls(reward, gamma):
    value = mc_returns(reward, np.array([0, len(reward)]), gamma)
    progress = value_progress(value, reward)
    np.testing.assert_allclose(np.diff(progress), (1 - gamma) * value[1:] / 25, atol=1e-6)


def test_a_satisfied_segment_keeps_its_weight_and_a_disappointment_loses_it():
    reward = np.zeros(60)
    reward[20:45] = 1
    value = mc_returns(reward, np.array([0, 60]), 0.98)
    gained = value_progress(value, reward)
    assert (gained[30:45] - gained[20:35] > 0.01).all()  # weigh 1 in lerobot
    assert (value[30:45] - value[20:35] < 0).all()  # which values alone would not
    failed = np.concatenate([value[:20], np.zeros(40)])  # expected, and never rewarded
    lost = value_progress(failed, np.zeros(60))
    assert (lost[20:30] - lost[10:20] < 0).all()
    assert lost[19] == pytest.approx(value[19] / 25)
