"""What was asked is asked again when, and only when, something changed that the answer depends on."""

import re
from dataclasses import replace

import pytest

from jiti.annotate.vlm.answers import Span
from jiti.annotate.vlm.settings import Settings
from jiti.errors import UsageError
from jiti.tasks.task import ITC, Criterion

CENTRED = ITC("t/centred", "It must be centred.", Criterion.TARGET_POSE_ACCURACY, "Look from above.", "(On a b)")
FRONT = ("/camera/front",)
SETTINGS = Settings("tiny", "http://127.0.0.1:8000/v1")
OTHER_RUNS = [
    replace(SETTINGS, url="http://elsewhere/v1"),
    replace(SETTINGS, cameras=FRONT),
    replace(SETTINGS, concurrency=1, timeout_s=1.0, retries=0),
]
"""The same model asked in another way. `cameras` is what a user named; those that are shown are told separately."""

SPAN = Span(1.0, 2.0, "it opens")


def located(settings: Settings = SETTINGS, instruction: str = "put it there", itc: ITC = CENTRED, cameras=FRONT) -> str:
    return settings.locate_key(instruction, itc, cameras)


@pytest.mark.parametrize(
    "other",
    [
        {"settings": replace(SETTINGS, model="other")},
        {"instruction": "put it here"},
        {"itc": replace(CENTRED, statement="It must be in the middle.")},
        {"itc": replace(CENTRED, check="")},
        {"itc": replace(CENTRED, criterion=Criterion.POSE_ALIGNMENT)},
        {"cameras": ("/camera/front", "/camera/wrist")},
        {"cameras": ("/camera/wrist",)},
    ],
)
def test_segments_are_asked_for_again_when_the_question_is_another(other):
    assert located(**other) != located()


@pytest.mark.parametrize(
    "other",
    [
        *({"settings": other} for other in OTHER_RUNS),
        {"settings": replace(SETTINGS, samples=7)},
        {"settings": replace(SETTINGS, fuse=False)},
        {"itc": replace(CENTRED, itc_id="t/renamed")},
        {"itc": replace(CENTRED, goal="(In a b)")},
    ],
)
def test_segments_are_kept_when_it_is_not(other):
    assert located(**other) == located()


def test_words_do_not_run_into_each_other():
    one, two = replace(CENTRED, statement="ab", check="c"), replace(CENTRED, statement="a", check="bc")
    assert located(itc=one) != located(itc=two)
    assert located(cameras=("a", "b")) != located(cameras=("ab",))


def decided(
    settings=SETTINGS, instruction="put it away", itc=CENTRED, cameras=("/camera/front",), spans=(SPAN,)
) -> str:
    return settings.decide_key(instruction, itc, cameras, spans)


def test_verdicts_are_asked_for_again_after_other_segments_samples_words_and_models():
    key = decided()
    assert decided(spans=(replace(SPAN, end_s=9.0),)) != key
    assert decided(spans=(replace(SPAN, evidence="other words for the same place"),)) == key
    assert decided(replace(SETTINGS, samples=5)) != key
    assert decided(replace(SETTINGS, model="other")) != key
    assert decided(instruction="put it down") != key
    assert decided(itc=replace(CENTRED, check="look")) != key
    assert decided(cameras=("/camera/wrist",)) != key
    for other in OTHER_RUNS:
        assert decided(other) == key


@pytest.mark.parametrize("instruction", ["", "größer\n大", "a" * 10**5])
def test_a_key_is_short_and_plain_and_never_empty(instruction):
    """An empty one stands for a stage that was not asked."""
    assert re.fullmatch("[0-9a-f]{16}", located(instruction=instruction))
    assert re.fullmatch("[0-9a-f]{16}", decided(instruction=instruction))


def test_half_a_character_in_an_instruction_has_a_key_as_well():
    assert located(instruction="put it \ud83d there") != located()


@pytest.mark.parametrize("samples", [0, -1, 51, 10**9])
def test_samples_that_make_no_sense_are_refused(samples):
    with pytest.raises(UsageError, match=f"--samples {samples} is not in 1 to 50"):
        Settings(samples=samples)


@pytest.mark.parametrize("samples", [1, 50])
def test_samples_at_the_ends_are_taken(samples):
    assert Settings(samples=samples).samples == samples
