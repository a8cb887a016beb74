"""The page beside an arm: a key counts for the question that it was pressed at, Space always, and a token is needed."""

import json
import urllib.error
import urllib.request
from urllib.parse import parse_qs, urlsplit

import pytest

from jiti.runtime.robot.page import Page
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.stops import Stopped, Stops
from tests.builders.arm_recording import write_arm_recording


@pytest.fixture
def stops():
    return Stops(keys=False)


@pytest.fixture
def page(stops):
    with Page(stops.press) as page:
        yield page


def ask(page: Page, path: str, body: dict | None = None, *, token: str | None = None):
    parts = urlsplit(page.url)
    token = parse_qs(parts.query)["token"][0] if token is None else token
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"http://{parts.netloc}{path}", data, {"Authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request, timeout=20) as answer:
        return answer.read()


def shown(page: Page) -> dict:
    return json.loads(ask(page, "/api/shown"))


def test_a_key_counts_for_the_question_that_it_was_pressed_at(page, stops):
    page.show(Shown("asking", "Did it succeed?", keys={"y": "yes", "n": "no"}))
    first = shown(page)
    assert [key for key, _, _ in first["keys"]] == ["y", "n", " "]
    page.show(Shown("asking", "Was it shut?", keys={"y": "yes", "n": "no"}))
    late = json.loads(ask(page, "/api/key", {"key": "y", "version": first["version"]}))
    other = json.loads(ask(page, "/api/key", {"key": "x", "version": shown(page)["version"]}))
    assert (late["counts"], other["counts"]) == (False, False)
    assert not stops.look()
    assert json.loads(ask(page, "/api/key", {"key": "y", "version": shown(page)["version"]}))["counts"]


def test_space_stops_from_any_page_and_enter_ends_an_episode(page, stops):
    page.show(Shown("running", "It moves.", keys={"\n": "end the episode"}))
    ask(page, "/api/key", {"key": "\n", "version": shown(page)["version"]})
    assert stops.look()
    ask(page, "/api/key", {"key": " "})
    with pytest.raises(Stopped, match="Space"):
        stops.look()


def test_the_first_key_counts_whether_terminal_or_page(page, stops):
    import threading

    panel = Panel(stops, lambda _said: None, page.show)
    question = Shown("asking", "Did it succeed?", keys={"y": "yes", "n": "no"})
    answers: list[str] = []
    thread = threading.Thread(target=lambda: answers.append(panel.ask(question)))
    thread.start()
    while not (now := shown(page))["keys"][1:]:
        pass
    while thread.is_alive():
        ask(page, "/api/key", {"key": "n", "version": now["version"]})
        thread.join(0.05)
    assert answers == ["n"]


def test_pictures_are_those_of_the_recording_that_is_shown(page, tmp_path):
    from urllib.error import HTTPError

    with pytest.raises(HTTPError, match="404"):
        ask(page, "/api/pictures")
    page.show(Shown("asking", "?", recording=write_arm_recording(tmp_path / "a.mcap", frames=7)))
    assert json.loads(ask(page, "/api/pictures"))["cameras"] == {"front": 7, "wrist": 7}
    assert ask(page, "/api/pictures/wrist/6").startswith(b"\xff\xd8\xff")
    for wrong in ("wrist/7", "side/0"):
        with pytest.raises(HTTPError, match="404"):
            ask(page, f"/api/pictures/{wrong}")


def test_without_the_token_nothing_is_told_and_nothing_stops(page, stops):
    for path, body in (("/api/shown", None), ("/api/key", {"key": " "}), ("/", None)):
        with pytest.raises(urllib.error.HTTPError, match="401"):
            ask(page, path, body, token="wrong")
    assert not stops.look()
