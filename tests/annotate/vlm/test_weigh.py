"""A verdict from several answers: what most of them say, and as sure as they were, together."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.vlm.answers import VERDICTS, Opinion
from jiti.annotate.vlm.ask import Asked
from jiti.annotate.vlm.backend import Answer, Token, Usage
from jiti.annotate.vlm.decide import weigh


def vote(satisfied: bool, p: float | None = None) -> Asked[Opinion]:
    """One answer; `p` is how likely its tokens made `satisfied`, None where the backend does not tell."""
    tokens: tuple[Token, ...] = ()
    if p is not None:
        likely = {v: math.log(q) for v, q in zip(VERDICTS, (p, 1 - p), strict=True) if q > 0}
        said = VERDICTS[0] if satisfied else VERDICTS[1]
        tokens = (Token('{"verdict":"', -0.01), Token(said, likely.get(said, -math.inf), likely), Token('"}', -0.01))
    return Asked(Opinion(satisfied, "because"), Answer("", False, Usage(), tokens))


@given(st.lists(st.booleans(), min_size=1, max_size=50))
@settings(deadline=None)
def test_without_probabilities_the_majority_decides_and_its_share_says_how_surely(said):
    satisfied, confidence = weigh([vote(s) for s in said])
    most = max(said.count(True), said.count(False))
    assert satisfied == (said[0] if said.count(True) == said.count(False) else said.count(True) == most)
    assert confidence == pytest.approx((most + 0.5) / (len(said) + 1))
    assert 0.5 <= confidence < 1


SURE = st.floats(0.5, 1).flatmap(lambda p: st.sampled_from([(True, p), (False, 1 - p)]))
"""A vote for what its tokens made the likelier, and how likely they made `satisfied`."""


@given(st.lists(SURE, min_size=1, max_size=12))
@settings(deadline=None)
def test_turning_every_answer_round_turns_the_verdict_round(votes):
    satisfied, confidence = weigh([vote(s, p) for s, p in votes])
    turned, same = weigh([vote(not s, 1 - p) for s, p in votes])
    assert same == pytest.approx(confidence, abs=1e-9) or same == pytest.approx(1 - confidence, abs=1e-9)
    if abs(confidence - 0.5) > 1e-9:
        assert turned is not satisfied
        assert same == pytest.approx(confidence, abs=1e-9)


@given(st.lists(st.floats(0.5, 1), min_size=1, max_size=12), st.booleans())
@settings(deadline=None)
def test_answers_that_agree_are_as_sure_as_they_were_and_a_little_less(sure, satisfied):
    """One sample that knows nothing counts with them."""
    found, confidence = weigh([vote(satisfied, p if satisfied else 1 - p) for p in sure])
    assert found is satisfied or confidence == pytest.approx(0.5)
    assert confidence == pytest.approx((sum(sure) + 0.5) / (len(sure) + 1))
    assert 0.5 <= confidence <= (max(sure) if max(sure) < 1 else 1 - 0.5 / (len(sure) + 1)) + 1e-9


@given(st.integers(1, 49))
def test_more_answers_that_agree_are_surer_and_never_certain(count):
    _, few = weigh([vote(True)] * count)
    _, more = weigh([vote(True)] * (count + 1))
    assert 0.5 < few < more < 1


@pytest.mark.parametrize("first", [True, False])
def test_a_tie_goes_to_the_first_answer(first):
    assert weigh([vote(first), vote(not first)]) == (first, 0.5)
    assert weigh([vote(first), vote(not first), vote(not first), vote(first)]) == (first, 0.5)
    assert weigh([vote(first, 0.75), vote(not first, 0.25)]) == (first, 0.5)


def test_of_as_many_votes_the_surer_ones_decide():
    assert weigh([vote(True, 0.6), vote(False, 0.1)]) == (False, pytest.approx(1 - 1.2 / 3))
    assert weigh([vote(True, 0.9), vote(False, 0.4)]) == (True, pytest.approx(1.8 / 3))


def test_verdicts_by_hand():
    assert weigh([vote(True)]) == (True, 0.75)
    assert weigh([vote(True), vote(False), vote(True)]) == (True, 0.625)
    assert weigh([vote(False)] * 3) == (False, 0.875)
    assert weigh([vote(True, 0.9)]) == (True, pytest.approx(0.7))
    assert weigh([vote(True, 0.9), vote(True, 0.8), vote(False, 0.3)]) == (True, pytest.approx(0.625))


def test_answers_without_probabilities_count_in_full_beside_those_with():
    assert weigh([vote(True), vote(True, 0.75)]) == (True, pytest.approx(0.75))


@pytest.mark.parametrize(
    "votes",
    [
        [(True, 0.51), (True, 0.51), (False, 0.01)],  # two that hardly know against one that does
        [(True, 0.9), (False, 0.6), (False, 0.6)],  # drawn at a temperature: not the likelier of two
    ],
)
def test_a_verdict_is_never_less_likely_than_its_contrary(votes):
    assert weigh([vote(s, p) for s, p in votes])[1] >= 0.5
