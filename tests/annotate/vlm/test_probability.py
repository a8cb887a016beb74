"""How sure a model was of its verdict is the same for every way to cut its answer into tokens."""

import json
import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.vlm.answers import VERDICTS
from jiti.annotate.vlm.backend import Token
from jiti.annotate.vlm.probability import choice_probability

RATIONALES = ["", "it drops", 'says "verdict": "violated"', "violated", "a\\b", "größer 🙂", "{}[]:,"]
SEPARATORS = [(",", ":"), (", ", ": "), (",\n ", " : "), (" , ", ":  ")]


def written(verdict: str, rationale: str, separators: tuple[str, str], *, last: bool) -> str:
    pairs = [("rationale", rationale), ("verdict", verdict)]
    return json.dumps(dict(pairs if last else pairs[::-1]), separators=separators)


def cut(text: str, edges: list[int]) -> list[str]:
    return [text[a:b] for a, b in pairwise([0, *sorted(edges), len(text)])]


@given(
    st.sampled_from(VERDICTS),
    st.sampled_from(RATIONALES),
    st.sampled_from(SEPARATORS),
    st.booleans(),
    st.floats(0.05, 0.95),
    st.floats(0.01, 1),
    st.data(),
)
@settings(max_examples=150, deadline=None)
def test_every_way_to_cut_an_answer_gives_the_same_probability(verdict, rationale, separators, last, p, mass, data):
    """Both verdicts are written out; a token that holds the value's first letter may be the other verdict's instead."""
    other = next(v for v in VERDICTS if v != verdict)
    said, instead = (written(v, rationale, separators, last=last) for v in (verdict, other))
    first = next(k for k, (a, b) in enumerate(zip(said, instead, strict=False)) if a != b)
    edges = data.draw(st.lists(st.integers(0, len(said)), max_size=len(said)))
    end = data.draw(st.integers(first + 1, len(instead)))
    tokens, start = [], 0
    for part in cut(said, edges):
        logprob, others = -0.01, {part: -0.01}
        if start <= first < start + len(part):
            logprob = math.log(p * mass)
            others = {part: logprob, instead[start:end]: math.log((1 - p) * mass)}
        tokens.append(Token(part, logprob, others))
        start += len(part)
    found = choice_probability(tokens, "verdict", VERDICTS)
    assert found is not None
    assert found == pytest.approx({verdict: p, other: 1 - p})


@pytest.mark.parametrize("size", range(1, 40))
def test_one_letter_a_token_and_the_whole_answer_in_one_agree(size):
    text = '{"rationale":"r","verdict":"violated"}'
    parts = [text[k : k + size] for k in range(0, len(text), size)]
    found = choice_probability([Token(part, -0.5) for part in parts], "verdict", VERDICTS)
    assert found == {"satisfied": 0.0, "violated": 1.0}


def around(*others: tuple[str, float], said: str = "satisfied", before: str = "") -> list[Token]:
    """An answer whose value begins with one of these tokens, with these probabilities."""
    likely = {before + text: math.log(p) for text, p in others}
    head, tail = '{"verdict":"', '","rationale":""}'
    return [
        Token(head.removesuffix(before), -0.1),
        Token(before + said, likely.get(before + said, -3.0), likely),
        Token("satisfied".removeprefix(said) + tail, -0.1),
    ]


@pytest.mark.parametrize("before", ["", '"', ':"'])
def test_every_beginning_of_a_choice_counts_for_it(before):
    tokens = around(("s", 0.1), ("sat", 0.2), ("satisfied", 0.3), ("v", 0.05), ("viol", 0.15), before=before)
    assert choice_probability(tokens, "verdict", VERDICTS) == pytest.approx({"satisfied": 0.75, "violated": 0.25})


def test_a_beginning_counts_with_other_space_and_quotes_before_it_too():
    tokens = around(("satisfied", 0.3), said="satisfied", before=':"')
    others = {':"satisfied': math.log(0.3), ' "viol': math.log(0.1), "violated": math.log(0.2)}
    tokens[1] = Token(tokens[1].text, math.log(0.3), others)
    assert choice_probability(tokens, "verdict", VERDICTS) == pytest.approx({"satisfied": 0.5, "violated": 0.5})


def test_what_begins_no_choice_counts_for_none():
    tokens = around(("satisfied", 0.3), ("violated", 0.1), ("Satisfied", 0.2), ("yes", 0.2), ("", 0.1), ('"', 0.1))
    assert choice_probability(tokens, "verdict", VERDICTS) == pytest.approx({"satisfied": 0.75, "violated": 0.25})


def test_the_token_that_was_taken_counts_where_it_is_not_among_the_likeliest():
    tokens = around(("violated", 0.5), said="sat")
    p = math.exp(-3.0)
    found = choice_probability(tokens, "verdict", VERDICTS)
    assert found == pytest.approx({"satisfied": p / (p + 0.5), "violated": 0.5 / (p + 0.5)})


def test_a_backend_that_gives_no_alternatives_leaves_no_doubt():
    tokens = [Token('{"verdict": "', -0.1), Token("violated", -0.7), Token('"}', -0.1)]
    assert choice_probability(tokens, "verdict", VERDICTS) == {"satisfied": 0.0, "violated": 1.0}


@pytest.mark.parametrize(
    "texts",
    [
        [],
        [""],
        ["satisfied"],
        ['{"verdict'],
        ['{"verdict"'],
        ['{"verdict":'],
        ['{"verdict":"'],
        ['{"verdict":""}'],
        ['{"verdict": 1}'],
        ['{"verdict": "yes"}'],
        ['{"rationale": "satisfied"}'],
        ['{"rationale": "\\"verdict\\": \\"satisfied\\""}'],
    ],
)
def test_an_answer_without_a_choice_has_no_probability(texts):
    assert choice_probability([Token(text, -0.1) for text in texts], "verdict", VERDICTS) is None


def test_tokens_that_cannot_be_have_no_probability():
    for never in (-math.inf, math.nan):
        tokens = [Token('{"verdict":"', -0.1), Token("satisfied", never, {"violated": never}), Token('"}', 0)]
        assert choice_probability(tokens, "verdict", VERDICTS) is None


@pytest.mark.parametrize("logprob", [1000.0, math.inf])
def test_a_logprob_over_certainty_counts_as_certainty(logprob):
    tokens = [Token('{"verdict":"', -0.1), Token("satisfied", logprob, {"violated": 0.0}), Token('"}', 0)]
    assert choice_probability(tokens, "verdict", VERDICTS) == {"satisfied": 0.5, "violated": 0.5}


def test_a_rationale_that_is_the_keys_name_is_not_the_key():
    text = '{"verdict": "satisfied", "rationale": "verdict"}'
    found = choice_probability([Token(letter, -0.1) for letter in text], "verdict", VERDICTS)
    assert found == {"satisfied": 1.0, "violated": 0.0}
