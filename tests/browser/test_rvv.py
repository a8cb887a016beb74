"""The validation viewer as a person uses it: find the worst suspect, fix it in the annotator, see it gone."""

from pathlib import Path

import pytest

from jiti.annotate.labels import read_segments
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment, new_segment_id
from jiti.annotate.store import LabelStore
from jiti.tasks.catalogue import load_catalogue
from tests.browser.conftest import Screen
from tests.builders.mcap import write_mcap

pytestmark = pytest.mark.browser

INSTRUCTION = "put the bowl on the plate"
FRAMES = 120


def label(folder: Path, annotator: str, episode_id: str, start: int, end: int, reward: int | None) -> None:
    """One accepted segment of 30 Hz frames."""
    task = load_catalogue().match(INSTRUCTION)
    assert task is not None
    itc = task.itcs[0]
    partition = LabelStore(folder / "labels").partition(annotator, episode_id, Recording(FRAMES, 30.0, "unknown"))
    segment = Segment(new_segment_id(), episode_id, itc.itc_id, str(itc.criterion), start, end, start, end, reward)
    partition.apply("mark", [segment], based_on=partition.version)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a", "b", "c"):
        write_mcap(tmp_path / f"{name}.mcap", duration_s=4, instruction=INSTRUCTION)
    return tmp_path


@pytest.mark.slow
def test_the_worst_suspect_is_fixed_in_the_annotator(serve, screen, folder: Path) -> None:
    label(folder, "ada", "a", 40, 64, 1)
    label(folder, "ada", "b", 40, 64, 0)
    label(folder, "ada", "c", 50, 53, 1)
    page = screen(serve("validate-rewards", "--annotator", "ada").url)
    row = page.page.locator("#suspects li[data-kind=too_short]")
    row.wait_for(timeout=60_000)
    with page.page.context.expect_page() as opened:
        row.locator("a").click()
    esa = Screen(opened.value)
    esa.wait(episode="c", frame=50)
    assert esa.state["selected"]
    esa.wait_numbers([50])
    for version in range(2, 9):
        esa.press(".").wait(version=version)
    page.page.bring_to_front()
    page.until(lambda: not row.is_visible(), lambda: "the fix in the viewer")
    ends = {r["episode_id"]: r["end_frame"] for r in read_segments(folder / "labels").to_pylist()}
    assert ends["c"] == 60
    assert page.errors == esa.errors == []


def test_gamma_changes_returns_live(serve, screen, folder: Path) -> None:
    label(folder, "ada", "a", 60, 84, 1)
    page = screen(serve("validate-rewards", "--annotator", "ada").url)
    page.until(lambda: "to" in page.page.inner_text("#scale"), lambda: "returns")
    before = page.page.inner_text("#scale")
    assert float(before.split()[-1]) == pytest.approx(sum(0.98**k for k in range(25)), rel=1e-2)
    page.page.fill("#gamma", "0.9")
    page.until(lambda: page.page.inner_text("#scale") != before, lambda: "new returns")
    assert float(page.page.inner_text("#scale").split()[-1]) == pytest.approx(sum(0.9**k for k in range(25)), rel=1e-2)


def test_differences_are_settled(serve, screen, folder: Path) -> None:
    label(folder, "ada", "a", 40, 64, 1)
    label(folder, "ben", "a", 41, 65, 0)
    page = screen(serve("validate-rewards", "--annotator", "ada").url)
    page.page.click("#tab-differences")
    page.until(lambda: "take ben" in page.page.inner_text("#differences"), lambda: "the difference")
    page.page.get_by_role("button", name="take ben").click()
    page.until(lambda: "No differences" in page.page.inner_text("#differences"), lambda: "no difference left")
    rows = read_segments(folder / "labels", annotators=["adjudicated"]).to_pylist()
    taken = [(r["start_frame"], r["end_frame"], r["reward"]) for r in rows if r["status"] == "accepted"]
    assert taken == [(41, 65, 0)]
