"""What a model may answer at each stage: the JSON schemas, and the reading of answers, which trusts nothing.

A schema is given to backends that can be held to it. Every answer is read as if it had not been: whatever does not fit
raises `BadAnswer`, whose text is what the model is told when it is asked once more.
"""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from jiti.tasks.task import Criterion

MOST_CONSTRAINTS = 4
"""ITCs of one task. Our choice: the paper's tasks have one each, its 273 inferred ITCs are one each for 273 tasks."""
MOST_SPANS = 3
"""Segments of one ITC in one episode. Our choice: tasks with two grasps have two, a slip adds one."""
MOST_TEXT = 240
"""Characters of a rationale, which is shown beside a video."""
MOST_STATEMENT = 240
_REPEATS = 120
VERDICTS = ("satisfied", "violated")

NOT_SHOWN = r"\x00-\x1f\x7f-\x9f\u00ad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\U000e0000-\U000e007f"
"""Inside of a regular expression's brackets: control characters, marks of direction, joiners, invisible letters."""

_BEFORE = re.compile(r"^\s*(?:<\|im_start\|>assistant\s*)?(?:(?:<think>)?.*?</think>)?", re.DOTALL)
"""What may stand in front: the start of the turn, which `transformers serve` repeats, and a model's thoughts."""
_FENCE = re.compile(r"^\s*```(?:json)?(.*)```\s*$", re.DOTALL)
_CONTROL = re.compile(f"[{NOT_SHOWN}]+")
_SLUG = re.compile(r"[^a-z0-9]+")


class BadAnswer(Exception):
    """An answer that cannot be used, and why, in words for the model. Not for users."""


@dataclass(frozen=True, slots=True)
class Constraint:
    """A proposed ITC of a task."""

    name: str
    statement: str
    criterion: Criterion
    check: str
    confidence: float
    """The model's own, 0 to 1."""


@dataclass(frozen=True, slots=True)
class Span:
    """Where an ITC is decided, in seconds since the first frame, with what is seen there."""

    start_s: float
    end_s: float
    evidence: str


@dataclass(frozen=True, slots=True)
class Opinion:
    """One sample of a verdict."""

    satisfied: bool
    rationale: str


def _text(most: int) -> dict[str, Any]:
    """Printable, without what JSON escapes: whoever is held to a pattern cannot answer with blanks or control codes.

    In parts, because xgrammar 0.2.8 fails on a pattern that repeats more than 128 times.
    """
    parts = [min(_REPEATS, most - 1 - start) for start in range(0, most - 1, _REPEATS)]
    letters = "".join(f"[ !#-\\[\\]-~]{{0,{count}}}" for count in parts)
    return {"type": "string", "pattern": f"^[A-Za-z0-9]{letters}$"}


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}


CONSTRAINTS_SCHEMA = _object(
    constraints={
        "type": "array",
        "minItems": 1,
        "maxItems": MOST_CONSTRAINTS,
        "items": _object(
            name=_text(40),
            criterion={"type": "string", "enum": [c.value for c in Criterion]},
            statement=_text(MOST_STATEMENT),
            check=_text(MOST_TEXT),
            confidence={"type": "number", "minimum": 0, "maximum": 1},
        ),
    }
)
OPINION_SCHEMA = _object(rationale=_text(MOST_TEXT), verdict={"type": "string", "enum": list(VERDICTS)})


def spans_schema(times_s: Sequence[float]) -> dict[str, Any]:
    """Of segments that begin and end at frames that are shown, in the letters that stand over them."""
    shown = {"type": "string", "enum": [shown_time(t) for t in sorted({round(t, 2) for t in times_s})]}
    segment = _object(evidence=_text(MOST_TEXT), start_s=shown, end_s=shown)
    return _object(segments={"type": "array", "minItems": 1, "maxItems": MOST_SPANS, "items": segment})


def shown_time(time_s: float) -> str:
    """A time since the first frame as it is burned in."""
    return f"{time_s:.2f}"


def read_constraints(text: str) -> list[Constraint]:
    """Raises BadAnswer."""
    found: list[Constraint] = []
    for item in _items(_load(text, "constraints"), "constraints", MOST_CONSTRAINTS):
        _keys(item, "name", "criterion", "statement", "check", "confidence")
        name = _SLUG.sub("-", _words(item, "name", 40).lower()).strip("-")
        if not name or any(name == other.name for other in found):
            raise BadAnswer(f"the name {_shown(item['name'])} has no letters or is there twice")
        if item["criterion"] not in [c.value for c in Criterion]:
            raise BadAnswer(f"criterion is {_shown(item['criterion'])}, not one of {', '.join(Criterion)}")
        confidence = _number(item, "confidence")
        if confidence > 1:
            raise BadAnswer(f"confidence is {confidence:g}, not in 0 to 1")
        statement, check = _words(item, "statement", MOST_STATEMENT), _words(item, "check", MOST_TEXT)
        found.append(Constraint(name, statement, Criterion(item["criterion"]), check, confidence))
    return found


def read_spans(text: str, duration_s: float) -> list[Span]:
    """In the order of their starts, each once; a start after its end changes places with it.

    Raises BadAnswer for one outside of 0 to `duration_s`.
    """
    found: list[Span] = []
    for item in _items(_load(text, "segments"), "segments", MOST_SPANS):
        _keys(item, "evidence", "start_s", "end_s")
        start_s, end_s = sorted((_number(item, "start_s"), _number(item, "end_s")))
        # Half a second over the end is how the last time that was burned in gets rounded up.
        if end_s > duration_s + 0.5:
            raise BadAnswer(f"a segment ends at {end_s:g} s, but the video ends at {duration_s:.2f} s")
        span = Span(min(start_s, duration_s), min(end_s, duration_s), _words(item, "evidence", MOST_TEXT))
        if all((span.start_s, span.end_s) != (other.start_s, other.end_s) for other in found):
            found.append(span)
    return sorted(found, key=lambda span: (span.start_s, span.end_s))


def read_opinion(text: str) -> Opinion:
    """Raises BadAnswer."""
    item = _load(text, "verdict")
    _keys(item, "rationale", "verdict")
    if item["verdict"] not in VERDICTS:
        raise BadAnswer(f"verdict is {_shown(item['verdict'])}, not one of {', '.join(VERDICTS)}")
    return Opinion(item["verdict"] == VERDICTS[0], _words(item, "rationale", MOST_TEXT))


def _load(text: str, key: str) -> dict[str, Any]:
    """The one JSON object of an answer, which may stand in a fence."""
    inside = _BEFORE.sub("", text)
    if found := _FENCE.match(inside):
        inside = found[1]
    try:
        value = json.loads(inside, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise BadAnswer(f"it is not one JSON object: {str(error)[:120]}") from error
    if not isinstance(value, dict) or key not in value:
        raise BadAnswer(f"it is not a JSON object with the key {key!r}")
    return value


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise ValueError("a key stands twice in one object")
    return dict(pairs)


def _items(value: dict[str, Any], key: str, most: int) -> list[dict[str, Any]]:
    _keys(value, key)
    items = value[key]
    if not isinstance(items, list) or not 1 <= len(items) <= most:
        raise BadAnswer(f"{key} must be a list of 1 to {most} objects")
    if not all(isinstance(item, dict) for item in items):
        raise BadAnswer(f"{key} must hold objects only")
    return items


def _keys(item: dict[str, Any], *names: str) -> None:
    if set(item) != set(names):
        there = ", ".join(map(_shown, islice(item, 8))) + (", ..." if len(item) > 8 else "")
        raise BadAnswer(f"an object has the keys {there or 'none'}, not {', '.join(names)}")


def _words(item: dict[str, Any], key: str, most: int) -> str:
    """A text on one line, without characters that would change how what is around it looks."""
    value = item[key]
    if not isinstance(value, str):
        raise BadAnswer(f"{key} is {_shown(value)}, not a text")
    plain = " ".join(_CONTROL.sub(" ", value.encode("utf-8", "ignore").decode()).split())
    if not 1 <= len(plain) <= most:
        raise BadAnswer(f"{key} has {len(plain)} characters, not 1 to {most}")
    return plain


def _number(item: dict[str, Any], key: str) -> float:
    """Also from a text: `"1.20"`, or `"1.20 s"` as it stands over a frame."""
    value = item[key]
    if isinstance(value, str):
        value = value.strip().removesuffix("s").strip()
    try:
        number = float("nan") if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not math.isfinite(number) or number < 0:
        raise BadAnswer(f"{key} is {_shown(value)}, not a number of 0 or more")
    return number


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
