"""The page beside an arm in real Chromium: an episode is judged by keys with its pictures at hand, and Space stops
whatever has the focus."""

from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest

from jiti.runtime.robot.evaluation.questions import Answers, ask
from jiti.runtime.robot.page import Page
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.stops import NEXT, Stopped, Stops
from jiti.tasks.catalogue import load_catalogue
from tests.builders.arm_recording import write_arm_recording

pytestmark = pytest.mark.browser
TASK = load_catalogue().task("so100/T5")


@pytest.fixture
def stops() -> Stops:
    return Stops(keys=False)


@pytest.fixture
def page(stops: Stops) -> Iterator[Page]:
    with Page(stops.press) as page:
        yield page


def test_an_episode_is_judged_by_keys_with_its_pictures_at_hand(page: Page, stops: Stops, screen, tmp_path: Path):
    recording = write_arm_recording(tmp_path / "so100-T5_0000.mcap")
    panel, answers = Panel(stops, lambda _said: None, page.show), list[Answers]()
    thread = Thread(target=lambda: answers.append(ask(panel, TASK, recording, "Episode 1 of 40")))
    thread.start()
    seen = screen(page.url).wait(phase="asking", recording=recording.name)
    assert "Did it succeed?" in seen.page.inner_text("#question")
    seen.until(lambda: seen.page.locator("#cameras img").count() == 2)
    seen.until(lambda: seen.page.evaluate("[...document.images].every((i) => i.naturalWidth === 64)"))
    seen.until(lambda: seen.page.input_value("#place") == "59", lambda: "the end of the recording")
    seen.press("y")
    seen.until(lambda: "smoothly" in seen.page.inner_text("#question"))
    seen.page.get_by_role("button", name="back").click()
    seen.until(lambda: "Did it succeed?" in seen.page.inner_text("#question"))
    seen.press("y")
    seen.until(lambda: "smoothly" in seen.page.inner_text("#question"))
    seen.press("n")
    thread.join(20)
    assert answers == [Answers(success=True, itcs={TASK.itcs[0].itc_id: False})]
    assert not seen.errors


def test_space_stops_whatever_has_the_focus(page: Page, stops: Stops, screen):
    page.show(Shown("running", "Space stops the arm at once.", keys={NEXT: "end the episode"}))
    seen = screen(page.url).wait(phase="running")
    seen.page.focus("#theme")
    seen.press("Space")

    def stopped() -> bool:
        try:
            stops.look()
        except Stopped:
            return True
        return False

    seen.until(stopped)
    assert seen.page.evaluate("document.documentElement.dataset.theme") == "light", "Space pressed no button"


def test_the_button_stops_it_too(page: Page, stops: Stops, screen):
    page.show(Shown("running", "Space stops the arm at once.", keys={NEXT: "end the episode"}))
    seen = screen(page.url).wait(phase="running")
    assert not stops.look()
    seen.page.get_by_role("button", name="Stop the arm").click()
    with pytest.raises(Stopped):
        seen.until(stops.look)


def test_a_recording_that_cannot_be_shown_does_not_freeze_the_page(page: Page, screen, tmp_path: Path):
    page.show(Shown("asking", "Did it succeed?", keys={"y": "yes"}, recording=tmp_path / "gone.mcap"))
    seen = screen(page.url).wait(phase="asking")
    page.show(Shown("running", "It moves.", keys={NEXT: "end the episode"}))
    seen.wait(phase="running")
    assert not seen.errors
