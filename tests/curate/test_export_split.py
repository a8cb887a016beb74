from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.curate.export.split import DEFAULT, parse_shares, split_episodes
from jiti.errors import UsageError


def test_every_stratum_is_divided_alike_and_the_same_way_each_time():
    strata = [(task, verdict) for task in range(8) for verdict in (0, 1) for _ in range(20)]
    names = split_episodes(strata, [False] * 320, DEFAULT, 0)
    assert names == split_episodes(strata, [False] * 320, DEFAULT, 0)
    assert names != split_episodes(strata, [False] * 320, DEFAULT, 1)
    for stratum in set(strata):
        here = Counter(name for name, other in zip(names, strata, strict=True) if other == stratum)
        assert here == {"train": 16, "validation": 2, "test": 2}


def test_unseen_tasks_are_held_out_whole_and_change_no_others():
    strata = [("a", 1)] * 10 + [("b", 1)] * 10
    alone = split_episodes(strata[:10], [False] * 10, DEFAULT, 3)
    both = split_episodes(strata, [False] * 10 + [True] * 10, DEFAULT, 3)
    assert both == alone + ["unseen"] * 10


STRATA = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 1)), min_size=1, max_size=200)


@given(STRATA, st.integers(1, 9), st.integers(0, 5))
def test_a_new_task_changes_the_splits_of_no_others(strata, more, seed):
    alone = split_episodes(strata, [False] * len(strata), DEFAULT, seed)
    new = [(-1, 1)] * more  # sorts first
    assert split_episodes(new + strata, [False] * (more + len(strata)), DEFAULT, seed)[more:] == alone


def test_small_strata_do_not_all_round_the_same_way():
    strata = [(task, verdict) for task in range(8) for verdict in (0, 1) for _ in range(5)]
    names = split_episodes(strata, [False] * 80, DEFAULT, 0)
    assert Counter(names) == {"train": 64, "validation": 8, "test": 8}
    one_verdict = split_episodes([(task, 1) for task in range(40) for _ in range(5)], [False] * 200, DEFAULT, 0)
    assert min(Counter(one_verdict).values()) >= 10


@given(STRATA, st.integers(0, 5))
def test_shares_are_kept_to_within_one_a_stratum(strata, seed):
    names = split_episodes(strata, [False] * len(strata), DEFAULT, seed)
    for stratum in set(strata):
        here = [name for name, other in zip(names, strata, strict=True) if other == stratum]
        for name, share in zip(("train", "validation", "test"), DEFAULT, strict=True):
            assert abs(here.count(name) - share * len(here)) <= 1 + 1e-6


@pytest.mark.parametrize("text", ["0.8,0.2", "a,b,c", "0.8,0.1,0.2", "1.2,-0.1,-0.1", "0,0.5,0.5", ""])
def test_shares_that_do_not_sum_up_are_refused(text):
    with pytest.raises(UsageError, match="Pass --split"):
        parse_shares(text)
