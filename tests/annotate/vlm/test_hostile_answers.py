"""Answers that nobody should give: each is a BadAnswer or comes out clean, at once, and is never another exception."""

import json
import math
import re
import unicodedata
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from jiti.annotate.vlm.answers import (
    MOST_CONSTRAINTS,
    MOST_SPANS,
    MOST_STATEMENT,
    MOST_TEXT,
    BadAnswer,
    Span,
    read_constraints,
    read_opinion,
    read_spans,
)
from jiti.tasks.task import Criterion

DURATION_S = 5.0
CONSTRAINT = {
    "name": "Set down softly",
    "criterion": "task_sequence_integrity",
    "statement": "It must not drop.",
    "check": "Pass: it rests when let go.",
    "confidence": 0.8,
}
SEGMENT = {"evidence": "the gripper opens", "start_s": "1.00", "end_s": "2.50"}
OPINION = {"rationale": "it is inside when let go", "verdict": "satisfied"}
READERS: dict[str, tuple[Callable[[str], Any], dict[str, Any]]] = {
    "constraints": (read_constraints, {"constraints": [CONSTRAINT]}),
    "segments": (lambda text: read_spans(text, DURATION_S), {"segments": [SEGMENT]}),
    "verdict": (read_opinion, OPINION),
}
"""Each with an answer that it reads."""
DEEP = 100_000
BIDI = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"


def spread(text: str) -> str:
    return " ".join(text.split())


def one(**changes: Any) -> str:
    return json.dumps({"constraints": [CONSTRAINT | changes]})


def opinion(**changes: Any) -> str:
    return json.dumps(OPINION | changes)


def in_place_of(value: str, *, of: str) -> str:
    """A whole answer of a kind with raw JSON where its first text was."""
    text = json.dumps(READERS[of][1])
    known = {"constraints": "0.8", "segments": '"1.00"', "verdict": '"it is inside when let go"'}[of]
    assert known in text
    return text.replace(known, value)


def check_clean(text: str, most: int) -> None:
    assert 1 <= len(text) <= most
    assert text == spread(text)
    assert not [c for c in text if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in BIDI]


def check_record(kind: str, found: Any) -> None:
    """What every record promises, whatever it was read from."""
    if kind == "verdict":
        assert type(found.satisfied) is bool
        check_clean(found.rationale, MOST_TEXT)
        return
    assert 1 <= len(found) <= {"constraints": MOST_CONSTRAINTS, "segments": MOST_SPANS}[kind]
    for item in found:
        if isinstance(item, Span):
            assert 0 <= item.start_s <= item.end_s <= DURATION_S
            check_clean(item.evidence, MOST_TEXT)
        else:
            assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", item.name)
            assert isinstance(item.criterion, Criterion)
            assert 0 <= item.confidence <= 1
            check_clean(item.statement, MOST_STATEMENT)
            check_clean(item.check, MOST_TEXT)
    if kind == "constraints":
        assert len({item.name for item in found}) == len(found)


def read_or_refuse(kind: str, text: str) -> None:
    """Any exception but BadAnswer fails the test."""
    try:
        found = READERS[kind][0](text)
    except BadAnswer:
        return
    check_record(kind, found)


@pytest.mark.parametrize("kind", READERS)
@given(text=st.text(st.characters()))
@settings(max_examples=40, deadline=None)
@example("")
@example("\ufeff{}")
@example("null")
@example("\x00")
@example("```json\n```")
def test_any_text_is_read_or_refused(kind, text):
    read_or_refuse(kind, text)


@pytest.mark.parametrize("kind", READERS)
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_a_good_answer_with_damage_in_it_is_read_or_refused(kind, data):
    text = json.dumps(READERS[kind][1])
    for _ in range(data.draw(st.integers(1, 3))):
        at, end = sorted(data.draw(st.tuples(*[st.integers(0, len(text))] * 2)))
        put = data.draw(
            st.sampled_from(['"', "{", "}", "[", "]", ",", "\\", "\\ud800", "NaN", "-1", "```", "</think>"])
        )
        text = text[:at] + put + text[data.draw(st.sampled_from([at, end])) :]
    read_or_refuse(kind, text)


ANY_JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from([math.inf, -math.inf, math.nan, 10**400, -1, "satisfied", "1.20 s", "nan", "1e999", "1" * 400])
    | st.text(st.characters(), max_size=300),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=9), inner, max_size=5),
    max_leaves=8,
)


@pytest.mark.parametrize("kind", READERS)
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_value_in_any_place_is_read_or_refused(kind, data):
    value = json.loads(json.dumps(READERS[kind][1]))
    holder = value if kind == "verdict" or data.draw(st.booleans()) else value[kind][0]
    holder[data.draw(st.sampled_from([*holder, "another"]))] = data.draw(ANY_JSON)
    read_or_refuse(kind, json.dumps(value, ensure_ascii=data.draw(st.booleans())))


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("nested", ["[" * DEEP, "[" * DEEP + "]" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP])
def test_an_answer_nested_without_end_is_refused(kind, nested):
    for text in (nested, in_place_of(nested, of=kind)):
        with pytest.raises(BadAnswer):
            READERS[kind][0](text)


@pytest.mark.parametrize("depth", [50, 300, 900, 1000, 2000, 9990, 10_000])
def test_a_list_of_any_depth_in_place_of_a_text_is_refused(depth):
    """Parsing and quoting have limits of their own; what passes the one must not fail the other."""
    with pytest.raises(BadAnswer):
        read_opinion(in_place_of("[" * depth + "]" * depth, of="verdict"))


@pytest.mark.parametrize(
    "value",
    ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "-0.1", "true", "false", "null", "[]", "{}", '"high"', '""']
    + ["1.5", "1" * 400, "1" * 5000, '"nan"', '"inf"', '"-1"', '"' + "9" * 10_000 + '"'],
)
def test_a_confidence_that_is_no_number_from_0_to_1_is_refused(value):
    with pytest.raises(BadAnswer):
        read_constraints(in_place_of(value, of="constraints"))


@pytest.mark.parametrize("value", ["NaN", "1e999", "-0.01", "true", "null", "[]", '"s"', '"1:00"', '"1.0 m"', "5.51"])
def test_a_time_that_is_none_or_outside_is_refused(value):
    with pytest.raises(BadAnswer):
        read_spans(in_place_of(value, of="segments"), DURATION_S)


@pytest.mark.parametrize("verdict", ["SATISFIED", "satisfied ", "yes", "", True, 1, None, ["satisfied"], {"a": 1}])
def test_a_verdict_outside_the_choice_is_refused(verdict):
    with pytest.raises(BadAnswer, match=r"verdict is .*, not one of satisfied, violated"):
        read_opinion(opinion(verdict=verdict))


@pytest.mark.parametrize("criterion", ["Pose_alignment", "beauty", "", None, 0, ["pose_alignment"]])
def test_a_criterion_outside_the_choice_is_refused(criterion):
    with pytest.raises(BadAnswer, match=r"criterion is .*, not one of task_sequence_integrity, "):
        read_constraints(one(criterion=criterion))


@pytest.mark.parametrize("kind", READERS)
def test_a_key_more_a_key_less_and_a_key_twice_are_refused(kind):
    read, good = READERS[kind]
    for key in good if kind == "verdict" else good[kind][0]:
        holder = dict(good if kind == "verdict" else good[kind][0])
        for changed in (holder | {"itc_id": "elegant/T1/other"}, {k: v for k, v in holder.items() if k != key}):
            with pytest.raises(BadAnswer):
                read(json.dumps(changed if kind == "verdict" else {kind: [changed]}))
        twice = json.dumps(holder)[:-1] + f", {json.dumps(key)}: {json.dumps(holder[key])}}}"
        with pytest.raises(BadAnswer, match="a key stands twice"):
            read(twice if kind == "verdict" else f'{{"{kind}": [{twice}]}}')
    with pytest.raises(BadAnswer):
        read(json.dumps(good | {"also": 1}))


@pytest.mark.parametrize("kind", ["constraints", "segments"])
def test_too_many_too_few_and_things_that_are_no_objects_are_refused(kind):
    read, good = READERS[kind]
    (item,) = good[kind]
    most = {"constraints": MOST_CONSTRAINTS, "segments": MOST_SPANS}[kind]
    many = [item | ({"name": f"name {k}"} if kind == "constraints" else {"start_s": k / 4}) for k in range(most + 1)]
    assert len(read(json.dumps({kind: many[:most]}))) == most
    for items in (many, [], item, "none", None, 1, [1], [item, None], [[item]]):
        with pytest.raises(BadAnswer, match=f"{kind} must"):
            read(json.dumps({kind: items}))


@pytest.mark.parametrize("text", ["{}", "[]", "null", "1", '"satisfied"', "satisfied", "{'verdict': 'satisfied'}"])
@pytest.mark.parametrize("kind", READERS)
def test_what_is_not_one_object_of_the_kind_is_refused(kind, text):
    with pytest.raises(BadAnswer):
        READERS[kind][0](text)


@pytest.mark.parametrize("kind", READERS)
def test_words_around_an_answer_and_two_answers_are_refused(kind):
    read, good = READERS[kind]
    text = json.dumps(good)
    for wrong in (
        f"Sure: {text}",
        f"{text} I hope this helps.",
        text + text,
        f"```json\n{text}\n```\n```json\n{text}\n```",
    ):
        with pytest.raises(BadAnswer):
            read(wrong)


@pytest.mark.parametrize("kind", READERS)
def test_a_million_characters_are_refused_in_few_words(kind):
    million = "x" * 10**6
    for text in (million, in_place_of(f'"{million}"', of=kind), '{"' + million + '": 1}'):
        with pytest.raises(BadAnswer) as refused:
            READERS[kind][0](text)
        assert len(str(refused.value)) < 300


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("verdict", opinion(**{f"key {k}": k for k in range(10_000)})),
        ("constraints", one(name="-" + " " * 10_000)),
    ],
)
def test_a_refusal_never_quotes_at_length(kind, text):
    with pytest.raises(BadAnswer) as refused:
        READERS[kind][0](text)
    assert len(str(refused.value)) < 600


@pytest.mark.timeout(1)
def test_an_open_fence_and_blanks_without_end_are_refused_at_once():
    with pytest.raises(BadAnswer):
        read_opinion("```json\n" + " " * 100_000)


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "text",
    [
        " " * 10**6,
        "```" * 10**5 + "x",
        "<think>" * 10**5,
        "<think>" + " " * 10**6,
        "<|im_start|>assistant" + " " * 10**6,
    ],
)
def test_repetition_without_end_is_refused_at_once(text):
    with pytest.raises(BadAnswer):
        read_opinion(text)


@given(st.text(st.characters(), max_size=300))
@settings(max_examples=60, deadline=None)
@example("\u202egnorw\u202c")
@example("\ud800")
@example("a\udfff\ud800b")
@example("a\x00\x1b[2Jb\x7f\x9b")
@example("one\ntwo\u2028three\u2029")
def test_a_rationale_comes_out_on_one_clean_line(rationale):
    try:
        found = read_opinion(opinion(rationale=rationale))
    except BadAnswer:
        assume(False)
    check_clean(found.rationale, MOST_TEXT)
    found.rationale.encode()
    kept = [c for c in rationale if c.isalnum() and unicodedata.category(c) != "Cs"]
    assert [c for c in found.rationale if c.isalnum()] == kept
