"""The pinned versions fit the project and name no host."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
REQUIREMENTS = [
    *PROJECT["dependencies"],
    *(r for name, extra in PROJECT["optional-dependencies"].items() if name != "all" for r in extra),
]


@pytest.fixture(scope="module")
def pins() -> dict[str, Requirement]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    found = [Requirement(line) for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(r.name): r for r in found}


@pytest.mark.parametrize("text", REQUIREMENTS)
def test_each_dependency_is_pinned_to_a_version_that_it_allows(pins, text):
    wanted = Requirement(text)
    pin = pins[canonicalize_name(wanted.name)]
    (exact,) = pin.specifier
    assert exact.operator == "=="
    assert wanted.specifier.contains(exact.version, prereleases=True)


def test_no_line_names_a_host_a_file_or_an_option(pins):
    assert len(pins) > len(REQUIREMENTS)
    assert all(pin.url is None for pin in pins.values())
    for line in (ROOT / "constraints.txt").read_text().splitlines()[1:]:
        assert not re.search(r"://|@|^-|\bfile:|--hash|--index|--find-links", line), line
