"""A real Qwen3-VL, tiny: in this process before any training, and behind `transformers serve` after some."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from jiti.annotate.command import Request, run_request
from jiti.annotate.events import find_events
from jiti.annotate.labels import read_segments
from jiti.annotate.vlm.answers import Span
from jiti.annotate.vlm.choose import Wish
from jiti.annotate.vlm.locate import overview
from jiti.annotate.vlm.prompts import decide_prompt, locate_prompt
from jiti.annotate.vlm.sampling import segment_frames
from jiti.annotate.vlm.sheets import contact_sheets
from jiti.annotate.web.app import create_app
from jiti.annotate.web.session import open_session
from jiti.annotate.window import frames_between
from jiti.episodes.reader import open_reader
from jiti.tasks.catalogue import load_catalogue
from tests.builders.demonstration import write_demonstration

# transformers and torch warn of each other's deprecations.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600), pytest.mark.filterwarnings("ignore")]

TASK = load_catalogue().task("elegant/T0")
LOCATED = '{"segments":[{"evidence":"the gripper opens","start_s":"1.00","end_s":"2.20"}]}'
SATISFIED = '{"rationale":"it rests when let go","verdict":"satisfied"}'


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("transformers", reason="needs pip install 'jiti[vlm]'")
    from tests.builders.tiny_vlm import build

    return build(tmp_path_factory.mktemp("untrained"))


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    write_demonstration(folder / "a.mcap", poses=False, steps=50)
    return folder


@pytest.fixture(scope="module")
def trained(untrained: Path, recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Overfitted to what the two stages ask about the recording."""
    from shutil import copytree

    from tests.builders.tiny_vlm import overfit

    folder = copytree(untrained, tmp_path_factory.mktemp("models") / "trained")
    reader = open_reader(recordings)
    episode = reader.open(reader.episodes()[0].episode_id)
    itc, cameras = TASK.itcs[0], ("/camera/front",)
    shown = overview(episode, cameras, find_events(episode))
    frames = segment_frames(episode.clock, *frames_between(episode.clock, 1.0, 2.2))
    views = [(camera, contact_sheets(episode, camera, frames)) for camera in cameras]
    span = Span(1.0, 2.2, "the gripper opens")
    lessons = [
        (locate_prompt(TASK.instruction, itc, shown.views, shown.times_s), LOCATED),
        (decide_prompt(TASK.instruction, itc, span, views, "", seed=0, temperature=0.0), SATISFIED),
    ]
    assert overfit(folder, lessons) < 0.01
    return folder


def label(recordings: Path, labels: Path, **wish):
    session = open_session(str(recordings), annotator="ada", labels=labels, tasks=None)
    done = run_request(Request("vlm", Wish(**wish)), session, lambda _share, _what: None)
    return session, done


def queue_of(session) -> list[dict]:
    """What the annotator's page is given."""
    app = create_app(session, token="secret", port=4322)
    client = TestClient(app, base_url="http://127.0.0.1:4322", headers={"Authorization": "Bearer secret"})
    (listed,) = client.get("/api/episodes").json()["episodes"]
    return client.get(f"/api/episodes/{listed['episode_id']}/rows").json()["proposals"]


@contextmanager
def transformers_serve(model: Path) -> Iterator[str]:
    """The address of a running `transformers serve`."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [str(Path(sys.executable).with_name("transformers")), "serve", str(model)]
    command += ["--host", "127.0.0.1", "--port", str(port), "--device", "cpu"]
    log = model.parent / f"serve-{port}.log"
    with log.open("wb") as file:
        server = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=os.environ | {"HF_HUB_OFFLINE": "1"},
        )
        try:
            _wait_for(port, server, log)
            yield f"http://127.0.0.1:{port}/v1"
        finally:
            os.killpg(server.pid, signal.SIGTERM)
            server.wait(30)


def _wait_for(port: int, server: subprocess.Popen, log: Path) -> None:
    end = time.monotonic() + 240
    while time.monotonic() < end:
        if server.poll() is not None:
            break
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
        except OSError:
            time.sleep(0.3)
        else:
            return
    pytest.fail(f"transformers serve does not answer: {log.read_text()[-2000:]}")


def test_before_any_training_guided_decoding_alone_makes_answers_valid(untrained, recordings, tmp_path):
    session, done = label(recordings, tmp_path / "labels", model=str(untrained), samples=2)
    assert done.failures == ()
    assert done.usage.requests + done.usage.cached == 2 * done.proposals + 1
    rows = queue_of(session)
    assert len(rows) == done.proposals >= 1
    for row in rows:
        assert row["source"] == "vlm"
        assert row["reward"] in (0, 1)
        assert 0 <= row["start_frame"] <= row["end_frame"] <= 49
        # Its tokens know next to nothing of the verdict, and the confidence says so.
        assert 0.5 <= row["confidence"] < 0.9


def test_an_untrained_model_behind_a_server_gives_failures_and_no_label(untrained, recordings, tmp_path):
    with transformers_serve(untrained) as url:
        session, done = label(recordings, tmp_path / "labels", url=url, model=str(untrained), samples=1)
    assert (done.proposals, done.satisfied, done.violated) == (0, 0, 0)
    assert len(done.failures) == 1
    assert "no usable answer, twice" in done.failures[0]
    assert queue_of(session) == []
    assert read_segments(tmp_path / "labels").num_rows == 0


def test_a_trained_model_behind_a_server_fills_the_queue(trained, recordings, tmp_path):
    with transformers_serve(trained) as url:
        # Named, because transformers before 5.6 does not list the model that it was started with.
        session, done = label(recordings, tmp_path / "labels", url=url, model=str(trained), samples=1)
    assert done.failures == ()
    assert done.usage.requests == 2
    (row,) = queue_of(session)
    assert (row["reward"], row["start_frame"], row["end_frame"]) == (1, 20, 44)
    assert "it rests when let go" in row["rationale"]
    assert "the gripper opens" in row["rationale"]


def test_a_trained_model_in_this_process_is_sure_of_its_verdict(trained, recordings, tmp_path):
    session, done = label(recordings, tmp_path / "labels", model=str(trained), samples=1)
    assert done.failures == ()
    (row,) = queue_of(session)
    assert (row["reward"], row["start_frame"], row["end_frame"]) == (1, 20, 44)
    assert row["confidence"] > 0.7
