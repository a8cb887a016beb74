"""What a wrong `meta/info.json` is answered with, and where its paths may lead."""

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.episodes.lerobot_info import load_info
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.errors import SourceError
from tests.builders.lerobot import (
    FRONT,
    read_episodes,
    read_info,
    write_episodes,
    write_info,
)
from tests.builders.lerobot_spoil import FIRST, said


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "demo/meta/info.json: is not JSON (Expecting property name enclosed in double quotes"),
        (b"[" * 100_000, "demo/meta/info.json: is not JSON"),
        (b"\xff\xfe\x00", "demo/meta/info.json: is not JSON"),
        (b"[1]", "demo/meta/info.json: is a JSON list; it must be an object"),
        (b"{}", "demo/meta/info.json: has no 'codebase_version'; it has nothing"),
    ],
)
def test_info_that_is_no_info(root: Path, content: bytes, message: str) -> None:
    (root / "meta/info.json").write_bytes(content)
    with pytest.raises(SourceError) as caught:
        LeRobotReader(root)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": None}, "fps is None; it must be a number above 0"),
        ({"fps": 0}, "fps is 0; it must be a number above 0"),
        ({"fps": -30}, "fps is -30"),
        ({"fps": "30"}, "fps is '30'"),
        ({"fps": float("nan")}, "fps is nan"),
        (
            {"codebase_version": "v1.6"},
            "codebase_version is 'v1.6'; jiti reads v3.0, v2.1 and v2.0. Convert the dataset",
        ),
        ({"codebase_version": "v4.0"}, "codebase_version is 'v4.0'; jiti reads v3.0, v2.1 and v2.0. Update jiti."),
        ({"codebase_version": 3}, "codebase_version is 3"),
        ({"features": []}, "features is list; it must be an object"),
        ({"features": {"action": {"shape": [2]}}}, "feature 'action' has no dtype"),
        ({"features": {"action": {"dtype": "float32", "shape": "two"}}}, "the shape of feature 'action' is 'two'"),
        ({"data_path": 7}, "data_path is 7; it must be a path template"),
    ],
)
def test_info_with_a_wrong_value_names_it(root: Path, change: dict[str, Any], message: str) -> None:
    write_info(root, read_info(root) | change)
    with pytest.raises(SourceError) as caught:
        LeRobotReader(root)
    assert str(caught.value).startswith("demo/meta/info.json: ")
    assert message in str(caught.value)


@pytest.mark.parametrize("key", ["codebase_version", "fps", "features"])
def test_info_that_lacks_a_key_names_it(root: Path, key: str) -> None:
    write_info(root, {k: v for k, v in read_info(root).items() if k != key})
    with pytest.raises(SourceError, match=rf"demo/meta/info\.json: has no '{key}'; it has "):
        LeRobotReader(root)


@pytest.mark.parametrize("key", ["data_path", "video_path"])
@pytest.mark.parametrize(
    "template",
    [
        "../../etc/{chunk_index}",
        "/etc/passwd",
        "~/{chunk_index}",
        "data/../../../x-{file_index:03d}",
        "data//x",
        "data\\..\\..\\x",
        "",
        "x\0y",
    ],
)
def test_paths_never_lead_outside_the_dataset(root: Path, key: str, template: str) -> None:
    write_info(root, read_info(root) | {key: template})
    with pytest.raises(SourceError, match=rf"demo/meta/info\.json: {key} .* not a place inside the dataset"):
        LeRobotReader(root).open(FIRST)


@pytest.mark.parametrize("template", ["data/{chunk_index.__class__}", "data/{chunk_index:99999999d}", "data/{}"])
def test_templates_can_do_nothing_but_fill_in_numbers(root: Path, template: str) -> None:
    write_info(root, read_info(root) | {"data_path": template})
    assert f"demo/{template}: the file is missing" in said(LeRobotReader(root).open(FIRST))


def test_a_template_that_asks_for_something_unknown(root: Path) -> None:
    write_info(root, read_info(root) | {"data_path": "data/{episode_index:06d}"})
    with pytest.raises(SourceError, match="asks for 'episode_index'; known are chunk_index, file_index"):
        LeRobotReader(root).open(FIRST)


def test_a_video_key_cannot_lead_outside(root: Path) -> None:
    info = read_info(root)
    info["features"]["../../x"] = info["features"][FRONT]
    write_info(root, info)
    rows = read_episodes(root)
    for row in rows:
        row |= {k.replace(FRONT, "../../x"): v for k, v in row.items() if FRONT in k}
    write_episodes(root, rows)
    with pytest.raises(SourceError, match="not a place inside the dataset"):
        LeRobotReader(root).open(FIRST)


@settings(deadline=None, max_examples=60)
@given(template=st.text(st.sampled_from("ab/.{}~\\:3d_" + "chunk_index"), max_size=30))
def test_no_template_gives_a_path_outside(template: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    root = tmp_path_factory.mktemp("d") / "demo"
    base = {"codebase_version": "v3.0", "fps": 30, "features": {}}
    write_info(root, base | {"data_path": template})
    try:
        path = load_info(root).data_file(chunk_index=1, file_index=2)
    except SourceError:
        return
    inside = os.path.normpath(root / path)
    assert inside.startswith(f"{root}{os.sep}")
