"""A run that was stopped goes on where it was, with the same bytes in the end; other inputs start anew."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from jiti.curate.export import build as build_module
from jiti.curate.export import digest as digest_module
from jiti.curate.export.digest import digest_of
from jiti.curate.export.features import Feature, Shape
from jiti.curate.export.planned import PlannedEpisode
from jiti.errors import SaveFailed
from jiti.tasks.catalogue import load_catalogue
from tests.builders.curate import curated, write_picks
from tests.builders.labels import full_disk, names_in, segment
from tests.builders.mcap import Camera

GOOD = [(2, 6, 1)]


@pytest.fixture(scope="module")
def demos(tmp_path_factory) -> Path:
    cameras = {"/camera/front": Camera(width=64, height=48)}
    return write_picks(tmp_path_factory.mktemp("resume") / "demos", [GOOD, GOOD, GOOD], cameras=cameras)


@contextmanager
def reading(*, stop_at: str = "") -> Iterator[list[str]]:
    """The episodes whose numbers are read, in order; a keyboard interrupt at one of them."""
    seen: list[str] = []
    real = build_module.read_numbers

    def noted(features, episode, *rest):
        if episode.episode_id == stop_at:
            raise KeyboardInterrupt
        seen.append(episode.episode_id)
        return real(features, episode, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build_module, "read_numbers", noted)
        yield seen


def stopped(demos: Path, out: Path, **options) -> None:
    """Leave a run of which the first two of three episodes are finished."""
    with reading(stop_at="pick_2") as seen, pytest.raises(KeyboardInterrupt, match="2 of 3 episodes are finished and"):
        curated(demos, out=out, **options)
    assert seen == ["pick_0", "pick_1"]
    assert not out.exists()


def assert_same(one: Path, other: Path) -> None:
    """Of every byte, but for the card, which has the folder's name."""
    files = [sorted(p.relative_to(root) for p in root.rglob("*") if p.is_file()) for root in (one, other)]
    assert files[0] == files[1]
    for path in files[0]:
        if path.name != "README.md":
            assert (one / path).read_bytes() == (other / path).read_bytes(), path


def test_a_killed_run_goes_on_and_gives_the_same(demos, tmp_path):
    curated(demos, out=tmp_path / "whole")
    killed = (
        "import os, signal, sys\n"
        "from jiti.curate.export import build\n"
        "real = build.read_numbers\n"
        "def once(features, episode, *rest):\n"
        "    if episode.episode_id == 'pick_2': os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return real(features, episode, *rest)\n"
        "build.read_numbers = once\n"
        "from pathlib import Path\n"
        "from jiti.curate.export.command import Request, curate\n"
        "curate(Request(sources=(sys.argv[1],), out=Path(sys.argv[2])))\n"
    )
    ended = subprocess.run([sys.executable, "-c", killed, str(demos), str(tmp_path / "d")], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert not (tmp_path / "d").exists()
    assert len((tmp_path / ".d.partial" / "journal.jsonl").read_text().splitlines()) == 2
    with reading() as seen:
        curated(demos, out=tmp_path / "d")
    assert seen == ["pick_2"]
    assert_same(tmp_path / "d", tmp_path / "whole")
    assert not (tmp_path / ".d.partial").exists()


def test_what_is_kept_and_taken_over_is_told(demos, tmp_path):
    with reading(stop_at="pick_0"), pytest.raises(KeyboardInterrupt, match="No episode was finished"):
        curated(demos, out=tmp_path / "d")
    stopped(demos, tmp_path / "d")
    assert curated(demos, out=tmp_path / "d").notes == ("2 of 3 episodes were there from a run that was stopped.",)
    assert curated(demos, out=tmp_path / "d", overwrite=True).notes == ()


@pytest.mark.parametrize(("file_bytes", "left"), [(10_000, ["pick_1"]), (20_000, [])])
def test_a_full_disk_leaves_nothing_and_the_next_run_goes_on(tmp_path, file_bytes, left):
    """Full when the second of two episodes is to be noted as finished, and when both are and tables are written."""
    picks = write_picks(tmp_path / "demos", [GOOD, GOOD])
    with full_disk(file_bytes), pytest.raises(SaveFailed) as error:
        curated(picks, out=tmp_path / "d")
    assert "file too large" in str(error.value)
    assert not (tmp_path / "d").exists()
    assert str(tmp_path / ".d.partial") in str(error.value)
    with reading() as seen:
        assert curated(picks, out=tmp_path / "d").episodes == 2
    assert seen == left
    assert names_in(tmp_path) == ["d", "demos"]


@pytest.mark.parametrize("options", [{"gamma": 0.5}, {"codec": "hevc"}, {"codec": "h264", "crf": 40}, {"fps": 15}])
def test_other_options_start_anew(demos, tmp_path, options):
    curated(demos, out=tmp_path / "whole", **options)
    stopped(demos, tmp_path / "d", codec="h264")
    with reading() as seen:
        curated(demos, out=tmp_path / "d", **({"codec": "h264"} | options))
    assert seen == ["pick_0", "pick_1", "pick_2"]
    if "codec" in options:
        assert_same(tmp_path / "d", tmp_path / "whole")
    for path in sorted((tmp_path / "whole" / "data").rglob("*.parquet")):  # with returns and times
        assert (tmp_path / "d" / path.relative_to(tmp_path / "whole")).read_bytes() == path.read_bytes()


def test_the_digest_follows_all_that_an_episode_is_made_of(monkeypatch):
    task = load_catalogue().task("elegant/T0")
    shapes = {"action": Shape("float32", (2,), ("a", "b"))}
    row = segment(2, 6, 1)
    episode = PlannedEpisode(
        "demos", "pick_0", "pick_0.mcap", "f00d", task.instruction, task, True, 30, (("ann", row),), 1, 0.1, 0.9, 0.2,
        {row.itc_id: 1}, (Feature("action", ("/action",)),),
    )  # fmt: skip
    plain = digest_of([episode], shapes, [30])
    assert plain == digest_of([replace(episode)], shapes, [30])
    goal = replace(task, itcs=(replace(task.itcs[0], goal="(On basket_1 table)"), *task.itcs[1:]))
    others = [
        replace(episode, task=goal),
        replace(episode, task=None),
        replace(episode, instruction="put it away"),
        replace(episode, success=False),
        replace(episode, fingerprint="beef"),
        replace(episode, split="test"),
        replace(episode, segments=(("ben", row),)),
        replace(episode, features=(Feature("action", ("/command",)),)),
    ]
    found = {digest_of([other], shapes, [30]) for other in others} | {digest_of([episode], shapes, [20])}
    assert len(found - {plain}) == len(others) + 1
    monkeypatch.setattr(digest_module, "__version__", "9.9")
    assert digest_of([episode], shapes, [30]) not in found | {plain}
