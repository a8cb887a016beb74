"""The annotator as a person uses it: real keys, and the Parquet file that results."""

import shutil
from itertools import pairwise
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from jiti.annotate.proposals import write_proposals
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment, new_segment_id
from jiti.annotate.store import LabelStore
from jiti.tasks.catalogue import load_catalogue
from tests.browser.conftest import Screen
from tests.builders.mcap import write_mcap

pytestmark = pytest.mark.browser

SHOWN = ("itc_id", "start_frame", "end_frame", "reward", "status")


@pytest.fixture(params=["made", pytest.param("real", marks=pytest.mark.slow)])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A folder with `episode.mcap`: one made here, and a recording that no one here wrote."""
    if request.param == "real":
        shutil.copy(request.getfixturevalue("shared") / "mcap" / "g1_pick.mcap", tmp_path / "episode.mcap")
    else:
        write_mcap(tmp_path / "episode.mcap", duration_s=10, instruction="put the bowl on the plate")
    return tmp_path


def parquet_rows(folder: Path, annotator: str) -> list[dict]:
    """The rows of the file as any reader of Parquet sees them."""
    path = folder / "labels" / "segments" / f"annotator={annotator}" / "episode.parquet"
    rows = pq.ParquetFile(path).read().to_pylist() if path.exists() else []
    return sorted(({k: row[k] for k in SHOWN} for row in rows), key=str)


def page_rows(screen: Screen) -> list[dict]:
    """The rows that the page has, own ones only, with what its list says of them checked against them."""
    rows = screen.page.evaluate("fetch('/api/episodes/episode/rows').then(r => r.json())")["segments"]
    listed = screen.page.eval_on_selector_all(
        "#segments button:not([data-kind=proposed])", "all => all.map(b => b.getAttribute('aria-label'))"
    )
    words = {1: "pass", 0: "fail", None: "undecided"}
    said = [f"frames {r['start_frame']} to {r['end_frame']}, {words[r['reward']]}" for r in rows]
    assert sorted(label.split(", ", 1)[1] for label in listed) == sorted(said)
    return sorted(({k: row[k] for k in SHOWN} for row in rows), key=str)


def test_labels_by_key_survive_reload_and_kill(serve, screen, folder: Path) -> None:
    server = serve("annotate", "episode.mcap", "--annotator", "ada")
    page = screen(server.url).ready().wait(frame=0, version=0)
    page.press("Shift+ArrowRight", "Shift+ArrowRight", "i").wait(frame=20, mark=20)
    page.press(*["Shift+ArrowRight"] * 3, "o").wait(segments=1, version=1)
    page.press("p").wait(version=2)
    page.press("]").wait(version=3)
    page.press("<").wait(version=4)
    first = page.page.evaluate("fetch('/api/episodes/episode/rows').then(r => r.json())")["segments"][0]
    assert (first["start_frame"], first["end_frame"], first["reward"]) == (21, 40, 1)

    page.press("2").press("End", "w").wait(segments=2, version=5)
    page.press("f").wait(version=6)
    page.press("Control+z").wait(version=7)
    page.press("z").wait(version=8, segments=1)
    page.press("Control+Shift+z", "Control+y").wait(version=10, segments=2)
    before = page_rows(page)
    assert [row["reward"] for row in before] == [1, 0] or [row["reward"] for row in before] == [0, 1]
    assert parquet_rows(folder, "ada") == before

    page.reload().ready().wait(version=10, segments=2)
    assert page_rows(page) == before

    page.press("j", "x").wait(version=11, segments=1)
    before = page_rows(page)
    server.kill()
    assert parquet_rows(folder, "ada") == before
    server.start()
    page.open(server.url).ready().wait(version=11, segments=1)
    assert page_rows(page) == before
    page.press("z").wait(version=12, segments=2)
    assert parquet_rows(folder, "ada") == page_rows(page)
    assert page.errors == []


@pytest.mark.slow
def test_two_annotators_at_the_same_time_lose_nothing(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=10)
    pages = {name: screen(serve("annotate", ".", "--annotator", name).url).ready() for name in ("ada", "ben")}
    for k in range(3):
        for name, page in pages.items():
            page.press("Shift+ArrowRight", "w").wait(segments=k + 1)
            page.press("p" if name == "ada" else "f").wait(version=2 * (k + 1))
    for name, reward in (("ada", 1), ("ben", 0)):
        assert [row["reward"] for row in parquet_rows(tmp_path, name)] == [reward] * 3


@pytest.mark.slow
def test_a_second_tab_is_told_what_changed(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=10)
    first, second = (serve("annotate", ".", "--annotator", "ada") for _ in range(2))
    page = screen(first.url).ready().wait(frame=0)
    other = screen(second.url).ready().wait(frame=0)
    other.page.route("**/api/version*", lambda route: route.abort())  # as when the tab was asleep
    page.press("w").wait(version=1)
    other.press("w")
    other.until(lambda: "mark window" in other.page.inner_text("#alert"), lambda: f"the refusal; {other.state}")
    other.wait(version=1, segments=1)
    other.press("w").wait(version=2, segments=2)
    assert len(parquet_rows(tmp_path, "ada")) == 2


def proposals(count: int) -> list[Segment]:
    """Proposals on frames 10k to 10k + 9, the later the surer."""
    return [
        Segment(
            segment_id=new_segment_id(),
            episode_id="episode",
            itc_id="elegant/T2/precisely_centered",
            criterion="target_pose_accuracy",
            start_frame=10 * k,
            end_frame=10 * k + 9,
            start_ns=k,
            end_ns=k + 1,
            reward=k % 2,
            status="proposed",
            source="signal",
            confidence=0.5 + k / 10,
            rationale=f"The gripper opens at frame {10 * k + 5}.",
        )
        for k in range(count)
    ]


def test_proposals_are_accepted_edited_and_rejected(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=10, instruction="put the bowl on the plate")
    task_itc = _itc_of("put the bowl on the plate")
    rows = [Segment.from_row({**p.to_row(), "itc_id": task_itc}) for p in proposals(3)]
    _propose(tmp_path / "labels", rows)
    page = screen(serve("annotate", ".", "--annotator", "ada").url).ready().wait(proposals=3, segments=0)
    assert parquet_rows(tmp_path, "ada") == []

    page.press("q").wait(selected=rows[0].segment_id, frame=0)  # the least sure comes first
    assert rows[0].rationale in page.page.inner_text("#inspector")
    page.press("a").wait(proposals=2, segments=1, selected=rows[1].segment_id)
    page.press("d").wait(proposals=1, segments=2)
    page.press(".").wait(version=3)
    page.press("q").wait(selected=rows[2].segment_id)
    page.press("r").wait(proposals=0, segments=3)
    found = {row["start_frame"]: row for row in parquet_rows(tmp_path, "ada")}
    assert {k: (row["status"], row["end_frame"]) for k, row in found.items()} == {
        0: ("accepted", 9),
        10: ("accepted", 20),
        20: ("rejected", 29),
    }
    full = pq.ParquetFile(tmp_path / "labels/segments/annotator=ada/episode.parquet").read().to_pylist()
    assert {row["parent_id"] for row in full} == {p.segment_id for p in rows}
    assert {row["start_frame"]: row["source"] for row in full} == {0: "signal", 10: "human", 20: "signal"}
    page.press("z").wait(proposals=1, segments=2)


@pytest.mark.slow
def test_every_key_of_the_viewer_is_the_annotators(serve, screen, tmp_path: Path) -> None:
    """Rerun binds Space, arrows, Home, End, digits and Ctrl+Z; with the focus in it they are still ours."""
    write_mcap(tmp_path / "episode.mcap", duration_s=10)
    page = screen(serve("annotate", ".").url).ready()
    page.page.locator("#viewer canvas").click(position={"x": 60, "y": 60})
    page.press("Home").wait(frame=0)
    page.press("ArrowRight", "ArrowRight").wait(frame=2)
    page.press("ArrowLeft").wait(frame=1)
    page.press("End").wait(frame=299)
    page.press("3").wait(lane="generic/pose_alignment")
    page.press("w").wait(version=1)
    page.press("Control+z").wait(version=2, segments=0)
    page.press("Home").wait(frame=0)
    page.press("Space").until(lambda: int(page.state["frame"]) > 0, lambda: "time to pass")
    page.press("Space").wait(playing="false")
    stopped = int(page.state["frame"])
    assert stopped > 0
    page.wait_numbers([stopped])


def test_hold_to_label_while_playing_and_loop(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=10)
    page = screen(serve("annotate", ".").url).ready()
    page.press("Space").wait(playing="true")
    page.until(lambda: int(page.state["frame"]) > 10)
    page.page.keyboard.down("h")
    page.until(lambda: int(page.state["mark"] or 999) + 20 < int(page.state["frame"]))
    page.page.keyboard.up("h")
    page.wait(segments=1)
    page.press("Space").wait(playing="false")
    row = page.page.evaluate("fetch('/api/episodes/episode/rows').then(r => r.json())")["segments"][0]
    assert row["end_frame"] - row["start_frame"] >= 20
    page.press("l").wait(playing="true")
    # The playhead stood behind the segment, and is brought to its start.
    page.until(lambda: row["start_frame"] <= int(page.state["frame"]) <= row["end_frame"])
    seen = [int(page.state["frame"])]
    page.until(lambda: seen.append(int(page.state["frame"])) or any(b < a for a, b in pairwise(seen)), lambda: "a loop")
    assert set(seen) <= set(range(row["start_frame"], row["end_frame"] + 1))
    page.press("l").wait(playing="false")


def test_keys_in_quick_succession_are_for_the_segment_that_was_just_marked(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", duration_s=10)
    write_mcap(tmp_path / "b.mcap", duration_s=10)
    page = screen(serve("annotate", ".", "--annotator", "ada").url).ready().wait(frame=0)
    far = ["Shift+ArrowRight"] * 4
    page.press("w", "f", *far, "w", "p", *far, "i", "ArrowRight", "o", "f", "n")
    page.wait(episode="b", segments=0)
    path = tmp_path / "labels" / "segments" / "annotator=ada" / "a.parquet"
    rows = sorted(pq.ParquetFile(path).read().to_pylist(), key=lambda row: row["start_frame"])
    assert [(r["start_frame"], r["end_frame"], r["reward"]) for r in rows] == [(0, 24, 0), (28, 52, 1), (80, 81, 0)]


def test_a_click_near_an_edge_does_not_move_it_but_dragging_does(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=10)
    page = screen(serve("annotate", ".").url).ready().wait(frame=0)
    page.press(*["Shift+ArrowRight"] * 10, "w").wait(version=1)  # frames 88 to 112 of 300
    box = page.page.locator("#lane-canvas").bounding_box()
    x, y = box["x"] + box["width"] * 113 / 300, box["y"] + 20 + 14 + 12
    page.page.mouse.click(x - 2, y)
    page.press("Home").wait(frame=0, version=1)
    page.page.mouse.move(x - 2, y)
    page.page.mouse.down()
    page.page.mouse.move(x - 2 + box["width"] * 20 / 300, y, steps=4)
    page.page.mouse.up()
    page.wait(version=2)
    row = page.page.evaluate("fetch('/api/episodes/episode/rows').then(r => r.json())")["segments"][0]
    assert (row["start_frame"], row["end_frame"]) == (88, 132)


def test_edges_snap_to_the_gripper(serve, screen, tmp_path: Path) -> None:
    recording = write_mcap(tmp_path / "episode.mcap", duration_s=10)
    page = screen(serve("annotate", ".").url).ready()
    page.until(lambda: int(page.state["events"]) > 0, lambda: "events")
    closes = (recording.gripper_closes_ns - recording.times_ns["/camera/front"][0]) / 1e9 * 30
    found = page.page.evaluate("fetch('/api/episodes/episode/events').then(r => r.json())")["events"]
    event = next(e["frame"] for e in found if e["kind"].startswith("gripper"))
    assert abs(event - closes) <= 5
    for before in [e["frame"] for e in found if e["frame"] <= event]:
        page.press("e").wait(frame=before)
    page.press("ArrowRight", "ArrowRight", "ArrowRight", "w").wait(version=1)
    page.press("Home", *["ArrowRight"] * (event + 4)).wait(frame=event + 4)
    page.press("I").wait(version=2)
    page.press("s").wait(version=3)
    row = page.page.evaluate("fetch('/api/episodes/episode/rows').then(r => r.json())")["segments"][0]
    assert row["start_frame"] == event


def test_a_key_is_remapped_for_good(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=4)
    server = serve("annotate", ".")
    page = screen(server.url).ready().wait(frame=0)
    page.press("?")
    page.page.click("[data-action=window]")
    page.press("g").press("Escape")
    page.press("g").wait(version=1)
    page.reload().ready().wait(version=1).press("w", "g").wait(version=2)


def test_a_key_that_is_taken_is_refused_in_the_dialog(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=4)
    page = screen(serve("annotate", ".").url).ready().wait(frame=0)
    page.press("?")
    page.page.click("[data-action=pass]")
    page.press("f")
    page.until(lambda: "f is already used" in page.page.inner_text("#keys-trouble"), lambda: "the refusal")
    page.page.click("[data-action=pass]")
    page.press("g")
    page.until(lambda: "g pass" in page.page.inner_text("#hint"), lambda: "the new key in the hint")


def test_keys_do_not_reach_an_episode_that_another_was_to_replace(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", duration_s=4)
    write_mcap(tmp_path / "b.mcap", duration_s=4)
    page = screen(serve("annotate", ".", "--annotator", "ada").url).ready().wait(episode="a", frame=0)
    page.press("w").wait(version=1)
    (tmp_path / "b.mcap").write_bytes(b"no recording any more")
    page.page.click("[data-episode=b]")
    page.wait(episode="", segments=0)
    page.until(lambda: "b.mcap" in page.page.inner_text("#alert"), lambda: "what is wrong")
    page.press("w", "p", "Delete")
    page.page.click("[data-episode=a]")
    page.wait(episode="a", segments=1, version=1)
    assert page.page.is_hidden("#alert")


def _itc_of(instruction: str) -> str:
    task = load_catalogue().match(instruction)
    assert task is not None
    return task.itcs[0].itc_id


def _propose(labels: Path, rows: list[Segment]) -> None:
    write_proposals(labels, "signal", "episode", rows, Recording(300, 30.0, "made"))
    assert LabelStore(labels).annotators() == ["signal"]
