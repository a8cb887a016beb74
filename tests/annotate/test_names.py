"""Names of annotators and episodes become file names, or an error that says why not."""

import getpass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.names import check_annotator, check_name, default_annotator, file_stem
from jiti.errors import LabelError


@pytest.mark.parametrize("name", ["anna", "Anna-2", "a.b_c@d+e", "Zoë", "王", "signal-2"])
def test_usable_names_stay_as_they_are(name: str) -> None:
    assert check_annotator(name) == name


def test_two_ways_to_write_a_letter_are_one_annotator() -> None:
    assert check_name("Zoe\u0308") == check_name("Zo\u00eb")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "is empty"),
        ("a/b", r"'a/b' has '/' in it.*Pass --annotator a-b\."),
        ("../x", r"has '/' in it.*Pass --annotator x\.|has '/' in it.*--annotator x"),
        ("a b", r"Pass --annotator a-b\."),
        ("a=b", "has '=' in it"),
        ("a%20", "has '%' in it"),
        ("a\nb", r"has '\\n' in it"),
        ("7", r"starts with '7'; it must start with a letter. Pass --annotator annotator-7\."),
        (".hidden", "starts with '.'"),
        ("_hidden", "starts with '_'"),
        ("x" * 201, "longer than 200 bytes"),
        ("signal", "kept for proposals"),
        ("VLM", "kept for proposals"),
        ("adjudicated", "kept for settled differences"),
    ],
)
def test_unusable_names_are_answered_with_what_to_do(name: str, message: str) -> None:
    with pytest.raises(LabelError, match=message):
        check_annotator(name)


@settings(deadline=None)
@given(st.text(max_size=30))
def test_whatever_the_login_is_the_default_is_usable(login: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(getpass, "getuser", lambda: login)
        assert check_annotator(default_annotator()) == default_annotator()


def test_the_default_is_the_login_without_its_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("LOGNAME", "LAB\\anna")
    assert default_annotator() == "anna"


def test_a_machine_without_login_names(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> str:
        raise KeyError("uid not found: 1234")

    monkeypatch.setattr(getpass, "getuser", nobody)
    assert default_annotator() == "annotator"


def test_episode_ids_are_file_names_that_dataset_readers_see() -> None:
    assert file_stem("day1%2Fpick") == "day1%2Fpick"
    assert file_stem("_pick") == "%5Fpick"
    for wrong in ("", "a/b", ".hidden", "..", "a\0b", "%5Fpick"):
        with pytest.raises(LabelError, match="cannot be a file name"):
            file_stem(wrong)
    with pytest.raises(LabelError, match="shorten the recording's name"):
        file_stem("x" * 300)
