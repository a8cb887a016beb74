"""A model is asked once, once more when its answer is bad, and never again for what it has answered well."""

import hashlib
import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.vlm.answers import BadAnswer, Opinion, read_opinion
from jiti.annotate.vlm.ask import SHOWN, Asker
from jiti.annotate.vlm.backend import NOTHING, Answer, ModelFailed, Picture, Prompt, Token, Usage
from jiti.annotate.vlm.cache import AnswerCache, prompt_key
from jiti.errors import SaveFailed

GOOD = '{"rationale": "it is inside", "verdict": "satisfied"}'
PROMPT = Prompt(
    "You judge.",
    ("Was it satisfied?", Picture(b"\xff\xd8 sheet", 64, 48)),
    "verdict",
    {"type": "object"},
    300,
    temperature=0.7,
    seed=1,
    chosen="verdict",
)
SPENT = Usage(requests=1, prompt_tokens=100, completion_tokens=10, seconds=0.5)


class Scripted:
    """A model that says what it is told to, in turn, and keeps what it was asked."""

    concurrency = 4

    def __init__(self, *says: str | Answer | ModelFailed, model: str = "tiny") -> None:
        self.model, self.asked = model, list[Prompt]()
        self._says, self._lock = iter(says), threading.Lock()

    def ask(self, prompt: Prompt) -> Answer:
        with self._lock:
            self.asked.append(prompt)
            said = next(self._says)
        if isinstance(said, ModelFailed):
            raise said
        return said if isinstance(said, Answer) else Answer(said, False, SPENT)


def kept_in(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_a_good_answer_is_asked_for_once(tmp_path):
    model = Scripted(GOOD)
    asked = Asker(model, AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    assert asked.value == Opinion(True, "it is inside")
    assert asked.answer.text == GOOD
    assert model.asked == [PROMPT]


def test_a_bad_answer_is_asked_once_more_with_what_was_wrong(tmp_path):
    model = Scripted('{"verdict": "satisfied"}', GOOD)
    assert Asker(model, AnswerCache(tmp_path)).ask(PROMPT, read_opinion).value.satisfied is True
    first, second = model.asked
    assert first == PROMPT
    assert second.parts[:-1] == PROMPT.parts
    words = second.parts[-1]
    assert isinstance(words, str)
    assert '{"verdict": "satisfied"}' in words
    assert "an object has the keys 'verdict', not rationale, verdict" in words
    assert replace(second, parts=PROMPT.parts) == PROMPT
    assert len(kept_in(tmp_path)) == 1


def test_two_bad_answers_are_a_failure_that_says_both_and_leave_nothing(tmp_path):
    model = Scripted("hm", '{"verdict": 1, "rationale": "x"}', GOOD)
    with pytest.raises(ModelFailed, match=r"tiny gave no usable answer, twice: it is not one .*; then: verdict is 1"):
        Asker(model, AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    assert len(model.asked) == 2
    assert kept_in(tmp_path) == []


def test_an_answer_that_was_cut_off_is_bad_even_if_it_reads_well(tmp_path):
    cut = Answer(GOOD, True, SPENT)
    model = Scripted(cut, GOOD)
    asked = Asker(model, AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    assert asked.answer.cut is False
    assert "it was longer than it may be, and was cut off" in str(model.asked[1].parts[-1])
    with pytest.raises(ModelFailed, match="twice: it was longer"):
        Asker(Scripted(cut, cut)).ask(PROMPT, read_opinion)


def test_a_long_bad_answer_is_shown_again_in_part():
    model = Scripted("x" * 100_000, GOOD)
    Asker(model).ask(PROMPT, read_opinion)
    words = str(model.asked[1].parts[-1])
    assert "x" * SHOWN in words
    assert "x" * (SHOWN + 1) not in words
    assert len(words) < SHOWN + 300


@pytest.mark.parametrize("says", [[ModelFailed("gone")], ["hm", ModelFailed("gone")]])
def test_a_model_that_fails_is_not_asked_again(tmp_path, says):
    model = Scripted(*says, GOOD)
    with pytest.raises(ModelFailed, match=r"^gone$"):
        Asker(model, AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    assert len(model.asked) == len(says)
    assert kept_in(tmp_path) == []


def test_what_was_answered_costs_nothing_in_the_next_run(tmp_path):
    tokens = (Token('{"', -0.5), Token("größer\n", -1.25, {"größer\n": -1.25, "}": -2.0}))
    answer = Answer(GOOD, False, SPENT, tokens)
    Asker(Scripted(answer), AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    asker = Asker(Scripted(), AnswerCache(tmp_path))
    assert asker.ask(PROMPT, read_opinion).answer == answer
    assert asker.ask(PROMPT, read_opinion).value == Opinion(True, "it is inside")
    assert asker.take_usage() == Usage(cached=2)


def test_a_repaired_answer_is_kept_for_the_question(tmp_path):
    Asker(Scripted("hm", GOOD), AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    assert Asker(Scripted(), AnswerCache(tmp_path)).ask(PROMPT, read_opinion).answer.text == GOOD


def test_without_a_cache_every_question_is_asked():
    model = Scripted(GOOD, GOOD)
    asker = Asker(model)
    for _ in range(2):
        asker.ask(PROMPT, read_opinion)
    assert len(model.asked) == 2


def test_a_kept_answer_that_no_longer_fits_is_asked_for_again(tmp_path):
    Asker(Scripted("old"), AnswerCache(tmp_path)).ask(PROMPT, str)
    model = Scripted(GOOD)
    asker = Asker(model, AnswerCache(tmp_path))
    assert asker.ask(PROMPT, read_opinion).value.satisfied is True
    assert asker.ask(PROMPT, read_opinion).value.satisfied is True
    assert len(model.asked) == 1
    assert asker.take_usage() == SPENT + Usage(cached=1)


def damaged(folder: Path, damage: Callable[[bytes], bytes]) -> Path:
    Asker(Scripted(GOOD), AnswerCache(folder)).ask(PROMPT, read_opinion)
    (path,) = kept_in(folder)
    path.write_bytes(damage(path.read_bytes()))
    return path


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda whole: whole[: len(whole) // 2],
        lambda whole: whole[:-1],
        lambda whole: b"\0" * len(whole),
        lambda _: b"\xff\xfe",
        lambda _: b"null",
        lambda _: b"[]",
        lambda _: b'"text"',
        lambda _: b"{}",
        lambda whole: whole.replace(b'"tokens": []', b'"tokens": [1]'),
        lambda whole: whole.replace(b'"requests"', b'"wishes"'),
    ],
)
def test_a_damaged_file_is_asked_for_again_and_replaced(tmp_path, damage):
    path = damaged(tmp_path, damage)
    model = Scripted(GOOD)
    assert Asker(model, AnswerCache(tmp_path)).ask(PROMPT, read_opinion).value.satisfied is True
    assert len(model.asked) == 1
    assert kept_in(tmp_path) == [path]
    assert Asker(Scripted(), AnswerCache(tmp_path)).ask(PROMPT, read_opinion).value.satisfied is True


@pytest.mark.parametrize(
    "text", [b'{"text": 5, "cut": false, "usage": {}, "tokens": []}', b"[" * 100_000], ids=["no text", "nested"]
)
def test_a_file_of_other_types_is_asked_for_again(tmp_path, text):
    damaged(tmp_path, lambda _: text)
    assert Asker(Scripted(GOOD), AnswerCache(tmp_path)).ask(PROMPT, read_opinion).value.satisfied is True


def test_an_answer_with_half_a_character_is_kept(tmp_path):
    half = Answer('{"rationale": "a\ud83d b", "verdict": "satisfied"}', False, SPENT, (Token("\ud83d", -1.0),))
    asked = Asker(Scripted(half), AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    assert asked.value == Opinion(True, "a b")
    assert Asker(Scripted(), AnswerCache(tmp_path)).ask(PROMPT, read_opinion).value == asked.value


TEXTS = st.text(max_size=30)
FLOATS = st.floats(allow_nan=False)
ANSWERS = st.builds(
    Answer,
    TEXTS,
    st.booleans(),
    st.builds(Usage, *[st.integers(0, 2**40)] * 3, st.floats(0, 1e9), st.integers(0, 9)),
    st.lists(st.builds(Token, TEXTS, FLOATS, st.dictionaries(TEXTS, FLOATS, max_size=3)), max_size=3).map(tuple),
)


@given(answer=ANSWERS)
@settings(max_examples=40, deadline=None)
def test_any_answer_comes_back_from_its_file(tmp_path_factory, answer):
    cache = AnswerCache(tmp_path_factory.mktemp("answers"))
    cache.put("ab12", answer)
    assert cache.get("ab12") == answer
    assert cache.get("ab13") is None


def test_a_cache_that_cannot_be_written_says_so(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(SaveFailed):
        Asker(Scripted(GOOD), AnswerCache(tmp_path / "file")).ask(PROMPT, read_opinion)


SHEET = next(part for part in PROMPT.parts if isinstance(part, Picture))
OTHERWISE: dict[str, tuple[str, Prompt]] = {
    "model": ("other", PROMPT),
    "system": ("tiny", replace(PROMPT, system="You judge!")),
    "words": ("tiny", replace(PROMPT, parts=("Was it violated?", SHEET))),
    "pixels": ("tiny", replace(PROMPT, parts=("Was it satisfied?", replace(SHEET, jpeg=b"\xff\xd8 shees")))),
    "one more picture": ("tiny", replace(PROMPT, parts=(*PROMPT.parts, SHEET))),
    "no picture": ("tiny", replace(PROMPT, parts=("Was it satisfied?",))),
    "order": ("tiny", replace(PROMPT, parts=PROMPT.parts[::-1])),
    "words apart": ("tiny", replace(PROMPT, parts=("Was it", " satisfied?", SHEET))),
    "schema": ("tiny", replace(PROMPT, schema={"type": "object", "properties": {}})),
    "seed": ("tiny", replace(PROMPT, seed=2)),
    "temperature": ("tiny", replace(PROMPT, temperature=0.0)),
    "length": ("tiny", replace(PROMPT, max_tokens=301)),
    "choice": ("tiny", replace(PROMPT, chosen="")),
}
"""The same question but for one thing."""


@pytest.mark.parametrize("what", OTHERWISE)
def test_another_question_has_another_key_and_is_asked(tmp_path, what):
    model, prompt = OTHERWISE[what]
    Asker(Scripted(GOOD), AnswerCache(tmp_path)).ask(PROMPT, read_opinion)
    other = Scripted(GOOD, model=model)
    Asker(other, AnswerCache(tmp_path)).ask(prompt, read_opinion)
    assert other.asked == [prompt]
    assert len(kept_in(tmp_path)) == 2


def test_no_two_of_these_questions_have_one_key():
    keys = [prompt_key(model, prompt) for model, prompt in OTHERWISE.values()]
    assert len({prompt_key("tiny", PROMPT), *keys}) == len(keys) + 1


def test_a_picture_is_not_mistaken_for_words_that_name_it():
    digest = hashlib.sha256(SHEET.jpeg).hexdigest()
    key = prompt_key("tiny", replace(PROMPT, parts=(SHEET,)))
    for words in (digest, json.dumps({"sha256": digest}), str({"sha256": digest}), SHEET.jpeg.decode("latin-1")):
        assert key != prompt_key("tiny", replace(PROMPT, parts=(words,)))


def test_what_is_spent_adds_up_over_threads_and_is_taken_once(tmp_path):
    count = 60
    model = Scripted(*["hm" if k % 3 == 0 else GOOD for k in range(3 * count)])
    asker = Asker(model, AnswerCache(tmp_path))
    failed = []

    def ask(seed: int) -> None:
        try:
            asker.ask(replace(PROMPT, seed=seed), read_opinion)
        except ModelFailed:
            failed.append(seed)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(ask, range(count)))
    asked = len(model.asked)
    spent = asker.take_usage()
    assert (spent.requests, spent.prompt_tokens, spent.completion_tokens) == (asked, 100 * asked, 10 * asked)
    assert spent.seconds == pytest.approx(0.5 * asked)
    assert asker.take_usage() == NOTHING
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(ask, [seed for seed in range(count) if seed not in failed]))
    assert asker.take_usage() == Usage(cached=count - len(failed))


@given(st.lists(st.tuples(*[st.integers(0, 10**6)] * 5), max_size=6))
def test_usage_adds_up(parts):
    total = sum((Usage(*part) for part in parts), NOTHING)
    assert total == Usage(*map(sum, zip(*parts, strict=True))) if parts else total == NOTHING


def test_usage_costs_its_tokens():
    assert Usage(3, 2_000_000, 500_000).cost((0.25, 2.0)) == 0.5 + 1.0


def test_a_reader_that_fails_otherwise_is_a_bug_and_shows():
    def broken(_text: str) -> None:
        raise KeyError("a bug")

    with pytest.raises(KeyError):
        Asker(Scripted(GOOD)).ask(PROMPT, broken)
    with pytest.raises(BadAnswer):
        read_opinion("hm")
