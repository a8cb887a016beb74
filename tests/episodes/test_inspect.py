"""What `jiti inspect` knows and shows."""

import io
import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from jiti.episodes.episode import Problem
from jiti.episodes.inspect import SourceReport, inspect_source, print_report, to_json
from tests.builders.lerobot import FRONT, write_v3
from tests.builders.mcap import Camera, write_mcap


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def printed(report: SourceReport, width: int = 80) -> str:
    console = Console(width=width, file=io.StringIO(), highlight=False)
    print_report(report, console)
    return console.file.getvalue()  # type: ignore[attr-defined]


def problems_of(report: SourceReport) -> list[Problem]:
    return [*report.problems, *(problem for episode in report.episodes for problem in episode.problems)]


def test_a_dataset(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "cups", (12, 30), tasks=("Pick up the red cup.", "Put it down."))
    report = inspect_source(root)
    assert report.title == "2 episodes in cups"
    assert report.labels_dir == str(root / "meta" / "jiti")
    first, second = report.episodes
    assert (first.episode_id, first.task, first.frame_count) == ("episode_000000", "Pick up the red cup.", 12)
    assert (second.clock_reference, second.rate_hz) == (FRONT, pytest.approx(30))
    assert second.duration_s == pytest.approx(29 / 30)
    assert first.fingerprint
    assert first.fingerprint != second.fingerprint
    assert [(s.name, s.kind, s.count) for s in first.streams] == [
        ("observation.state", "numeric", 12),
        ("action", "numeric", 12),
        (FRONT, "camera", 12),
        ("next.reward", "numeric", 12),
    ]
    assert not problems_of(report)


def test_the_json_is_plain_and_whole(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "cups", (12, 9))
    shutil.rmtree(root / "videos")
    report = inspect_source(root)
    plain = json.loads(json.dumps(to_json(report), allow_nan=False))
    assert list(plain) == ["title", "labels_dir", "episodes", "problems"]
    assert plain["episodes"][1]["frame_count"] == 9
    assert plain["episodes"][1]["clock_reference"] is None
    assert plain["episodes"][0]["streams"][0]["names"] == ["frame", "episode", "gripper.pos"]
    assert plain["episodes"][0]["problems"][0]["severity"] == "error"
    assert "the video is missing" in plain["episodes"][0]["problems"][0]["what"]


def test_json_is_printed_for_scripts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = inspect_source(write_v3(tmp_path / "cups", (12,)))
    print_report(report, as_json=True)
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(to_json(report)))


def test_a_folder_with_good_and_bad_files(tmp_path: Path) -> None:
    root = tmp_path / "demos"
    root.mkdir()
    write_mcap(root / "pick1.mcap", cameras={"/camera": Camera(width=64, height=48, rate_hz=10.0)}, duration_s=1.0)
    (root / "pick2.mcap").write_bytes(b"")
    report = inspect_source(root)
    assert [episode.frame_count for episode in report.episodes] == [10, None]
    assert [len(episode.problems) for episode in report.episodes] == [0, 1]
    assert len(problems_of(report)) == 1
    assert report.readable
    text = printed(report)
    assert "pick1.mcap" in text
    assert "/camera" in text
    assert "error: pick2.mcap: it is empty" in text


def test_the_text_fits_80_columns(tmp_path: Path) -> None:
    root = write_v3(
        tmp_path / "cups", (12, 30), encoder="images", cameras=(FRONT, "observation.images.left_wrist_camera")
    )
    text = printed(inspect_source(root))
    lines = text.splitlines()
    assert lines[0] == "2 episodes in cups"
    assert max(len(line) for line in lines if "labels" not in line) <= 80
    assert "observation.images.left_wrist_camera  camera" in text
    assert "120x160x3" in text
    assert "Streams of episode 0, and of 1 more" in text
    assert lines[-1] == "No problems found."


def test_one_episode_shows_its_facts(tmp_path: Path) -> None:
    path = tmp_path / "pick.mcap"
    cameras = {"/front": Camera(width=64, height=48, rate_hz=10.0)}
    write_mcap(path, cameras=cameras, duration_s=2.0, instruction="Pick up the red cup.")
    text = printed(inspect_source(path))
    assert "task    Pick up the red cup." in text
    assert "frames  20 at 10 Hz, 1.90 s" in text
    assert "clock   /front" in text


def test_streams_that_differ_are_shown_apart(tmp_path: Path) -> None:
    root = tmp_path / "demos"
    root.mkdir()
    for name in ("a", "b", "c"):
        cameras = {f"/{'odd' if name == 'b' else 'usual'}": Camera(width=64, height=48, rate_hz=10.0)}
        write_mcap(root / f"{name}.mcap", cameras=cameras, duration_s=0.5)
    text = printed(inspect_source(root))
    assert "Streams of a.mcap, and of 1 more" in text
    assert "Streams of b.mcap" in text
    assert text.index("/usual") < text.index("/odd")


def test_a_long_list_is_cut_in_the_terminal_only(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "cups", (2,) * 40, size=(64, 48))
    report = inspect_source(root)
    text = printed(report)
    assert "episode 29 " in text
    assert "episode 30 " not in text
    assert "... and 10 more episodes; --json lists all" in text
    assert len(to_json(report)["episodes"]) == 40


def test_only_the_first_are_opened_when_asked(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "cups", (2, 3, 4))
    seen = []
    report = inspect_source(root, limit=1, progress=lambda done, of: seen.append((done, of)))
    assert [bool(episode.streams) for episode in report.episodes] == [True, False, False]
    assert [episode.frame_count for episode in report.episodes] == [2, 3, 4]
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_brackets_in_names_are_text(tmp_path: Path) -> None:
    root = tmp_path / "demos"
    root.mkdir()
    for name in ("[bold]a", "b"):
        write_mcap(root / f"{name}.mcap", cameras={"/[red]cam": Camera(width=64, height=48)}, duration_s=0.2)
    text = printed(inspect_source(root))
    assert "[bold]a.mcap" in text
    assert "/[red]cam" in text


def test_the_real_dataset(shared: Path) -> None:
    report = inspect_source(shared / "lerobot" / "bimanual_v3")
    assert [episode.frame_count for episode in report.episodes] == [429, 395, 449, 408]
    assert not problems_of(report)
    assert "h264 from mpeg4" in printed(report)


@pytest.mark.parametrize("name", ["g1_pick", "franka_teleop", "camera_json", "rosbag2_talker"])
def test_the_real_recordings(shared: Path, name: str) -> None:
    report = inspect_source(shared / "mcap" / f"{name}.mcap")
    json.dumps(to_json(report), allow_nan=False)
    lines = printed(report).splitlines()
    assert max(len(line) for line in lines if not line.startswith("labels")) <= 80
