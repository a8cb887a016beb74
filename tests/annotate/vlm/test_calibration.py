"""A temperature puts a model's confidence right, is found from verdicts, and is kept a model in a file."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.vlm.calibration import LEAST, Calibration, fit, read_calibration, write_calibration

STEP = 1.15
"""From one temperature that is tried to the next."""
STEP_LOSS = 2e-3
"""A verdict: 1 and the doubles are not on the grid of temperatures, and may lie a little nearer to the best."""
COARSE = Calibration(2.5, 120)


def verdicts(temperature: float, count: int, seed: int, *, most: float = 0.97) -> tuple[list[float], list[bool]]:
    """Confidences of a model, right as often as that temperature says."""
    rng = np.random.default_rng(seed)
    confidences = rng.uniform(0.5, most, count)
    often = [Calibration(temperature).apply(c) for c in confidences]
    return confidences.tolist(), (rng.random(count) < often).tolist()


def log_loss(temperature: float, confidences: list[float], correct: list[bool]) -> float:
    """By the definition, from logits, so that no probability rounds to 1."""
    logits = [math.log(c / (1 - c)) / temperature for c in confidences]
    return sum(math.log1p(math.exp(-z if right else z)) for z, right in zip(logits, correct, strict=True))


@settings(max_examples=50)
@given(st.floats(0, 1))
def test_a_temperature_of_one_changes_nothing(confidence):
    assert Calibration().apply(confidence) == pytest.approx(confidence, abs=2e-6)


@settings(max_examples=50)
@given(st.floats(0.1, 94), st.floats(0, 1), st.floats(0, 1))
def test_what_was_surer_stays_surer(temperature, a, b):
    low, high = sorted((a, b))
    assert 0 <= Calibration(temperature).apply(low) <= Calibration(temperature).apply(high) <= 1


@settings(max_examples=50)
@given(st.floats(0.1, 94), st.floats(0, 1))
def test_both_verdicts_are_treated_alike(temperature, p):
    scaled = Calibration(temperature)
    assert scaled.apply(p) + scaled.apply(1 - p) == pytest.approx(1)
    assert scaled.apply(0.5) == 0.5


@settings(max_examples=50)
@given(st.floats(1.1, 94), st.floats(0.51, 1))
def test_heat_takes_confidence_and_never_the_verdict(temperature, confidence):
    assert 0.5 < Calibration(temperature).apply(confidence) < confidence
    assert Calibration(1 / temperature).apply(confidence) >= min(confidence, 1 - 1e-6)


def test_a_temperature_by_hand():
    assert Calibration(2.0).apply(0.9) == pytest.approx(0.75)  # odds 9:1, square root 3:1
    assert Calibration(0.5).apply(0.75) == pytest.approx(0.9)


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.0, 4.0])
def test_the_temperature_that_verdicts_were_drawn_with_is_found(temperature):
    found = fit(*verdicts(temperature, 2000, seed=3))
    assert found.verdicts == 2000
    assert 1 / STEP**1.5 < found.temperature / temperature < STEP**1.5


@given(st.integers(LEAST, 60), st.integers(0, 2**32 - 1), st.floats(0.3, 5))
@settings(max_examples=12, deadline=None)
def test_no_other_temperature_has_less_loss(count, seed, temperature):
    confidences, correct = verdicts(temperature, count, seed)
    found = fit(confidences, correct).temperature
    least = log_loss(found, confidences, correct)
    for other in (1.0, found * STEP, found / STEP, found * 2, found / 2):
        if 0.1 <= other <= 0.1 * STEP**49:
            assert least <= log_loss(other, confidences, correct) + STEP_LOSS * count


def test_a_model_that_is_always_right_gets_surer_and_one_that_guesses_knows_nothing():
    confidences = [0.6, 0.7, 0.8, 0.9] * 10
    assert fit(confidences, [True] * 40).temperature < 0.2
    guessing = fit(confidences, [True, False] * 20)
    assert guessing.apply(0.9) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("count", [0, 1, LEAST - 1])
def test_few_verdicts_change_nothing(count):
    assert fit([0.9] * count, [False] * count) == Calibration()


def test_as_many_as_are_needed_are_used():
    assert fit([0.9] * LEAST, [False] * LEAST).verdicts == LEAST


def test_a_verdict_too_many_is_a_bug():
    with pytest.raises(ValueError, match="zip"):
        fit([0.9] * (LEAST + 1), [True] * LEAST)


@pytest.mark.parametrize("confidence", [0.98, 0.9902, 0.999999, 1.0])
def test_a_mistake_of_a_sure_model_can_be_fitted(confidence):
    found = fit([confidence] * LEAST, [False, *[True] * (LEAST - 1)])
    assert found.apply(confidence) == pytest.approx(1 - 1 / LEAST, abs=0.02)


def test_what_is_written_is_read_for_that_model_only(tmp_path):
    write_calibration(tmp_path / "labels", "a/model", COARSE)
    write_calibration(tmp_path / "labels", "b", Calibration(0.7, 33))
    write_calibration(tmp_path / "labels", "b", Calibration(0.8, 66))
    assert read_calibration(tmp_path / "labels", "a/model") == COARSE
    assert read_calibration(tmp_path / "labels", "b") == Calibration(0.8, 66)
    assert read_calibration(tmp_path / "labels", "c") == Calibration()


def damaged(folder: Path, text: bytes) -> Path:
    (folder / "vlm").mkdir()
    (folder / "vlm" / "calibration.json").write_bytes(text)
    return folder


DAMAGE = [b"", b"{", b"\xff\xfe\x00", b'{"m": {"heat": 2}}', b'{"m": {}', b'{"m": 2}', b'{"m": null}']


@pytest.mark.parametrize("text", [*DAMAGE, b"[]", b"null", b"7"])
def test_a_damaged_file_changes_no_confidence(tmp_path, text):
    assert read_calibration(damaged(tmp_path, text), "m") == Calibration()


@pytest.mark.parametrize("text", DAMAGE)
def test_a_damaged_file_is_written_anew(tmp_path, text):
    write_calibration(damaged(tmp_path, text), "m", COARSE)
    assert read_calibration(tmp_path, "m") == COARSE
    assert json.loads((tmp_path / "vlm" / "calibration.json").read_bytes())["m"]["verdicts"] == 120


@pytest.mark.parametrize("text", [b"[]", b"null", b"7"])
def test_a_file_that_is_no_object_is_written_anew(tmp_path, text):
    write_calibration(damaged(tmp_path, text), "m", COARSE)
    assert read_calibration(tmp_path, "m") == COARSE


@pytest.mark.parametrize("temperature", ["0", "-1", '"hot"', "null", "NaN"])
def test_a_temperature_that_cannot_be_changes_no_confidence(tmp_path, temperature):
    folder = damaged(tmp_path, f'{{"m": {{"temperature": {temperature}, "verdicts": 99}}}}'.encode())
    assert 0.5 <= read_calibration(folder, "m").apply(0.9) <= 1
