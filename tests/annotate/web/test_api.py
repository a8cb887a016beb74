"""The annotator's answers: what the page is told, what it may write, what it is refused."""

import resource
from collections.abc import Callable
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from jiti.annotate.web.session import Session

Client = Callable[[Session], TestClient]

ITC = "elegant/T2"


@pytest.fixture
def api(client: Client, session: Session) -> TestClient:
    return client(session)


def put(api: TestClient, based_on: int = 0, **fields) -> object:
    episode = api.get("/api/episodes/episode").json()
    row = {"itc_id": episode["task"]["itcs"][0]["itc_id"], "start_frame": 3, "end_frame": 9, "reward": 1, **fields}
    return api.post("/api/episodes/episode/edits", json={"action": "mark", "put": [row], "based_on": based_on})


def test_episodes_are_listed_with_how_far_they_are(api: TestClient) -> None:
    put(api)
    rows = {row["episode_id"]: row for row in api.get("/api/episodes").json()["episodes"]}
    assert set(rows) == {"episode", "other"}
    assert rows["episode"]["segments"] == 1
    assert rows["other"]["segments"] == 0


def test_an_episode_tells_its_clock_and_its_task(api: TestClient) -> None:
    answer = api.get("/api/episodes/episode").json()
    assert answer["frame_count"] == 60
    assert answer["display_ns"][:2] == [0, 33_333_333]
    assert answer["task"]["task_id"] == ITC
    assert answer["version"] == 0


def test_the_server_works_out_times_and_criterion(api: TestClient, session: Session) -> None:
    answer = put(api)
    assert answer.status_code == 200, answer.text
    row = answer.json()["changed"][0]
    clock = session.episode("episode").clock
    assert (row["start_ns"], row["end_ns"]) == (int(clock.frame_ns[3]), int(clock.frame_ns[9]))
    assert row["criterion"] == "target_pose_accuracy"
    assert (row["source"], row["status"]) == ("human", "accepted")


def test_a_page_that_takes_over_what_each_answer_changed_holds_what_the_server_holds(api: TestClient) -> None:
    held, version = {}, 0

    def send(path: str, **body) -> None:
        nonlocal version
        answer = api.post(f"/api/episodes/episode/{path}", json={"based_on": version, **body}).json()
        for segment_id in answer["removed"]:
            del held[segment_id]
        held.update({row["segment_id"]: row for row in answer["changed"]})
        version = answer["version"]
        now = api.get("/api/episodes/episode/rows").json()
        assert now["version"] == version
        assert held == {row["segment_id"]: row for row in now["segments"]}

    itc_id = api.get("/api/episodes/episode").json()["task"]["itcs"][0]["itc_id"]
    marks = [{"itc_id": itc_id, "start_frame": f, "end_frame": f + 5, "reward": 1} for f in (0, 10, 20)]
    send("edits", action="mark", put=marks)
    assert len(held) == 3
    first, second, _ = sorted(held.values(), key=lambda row: row["start_frame"])
    send("edits", action="nudge", put=[{**first, "end_frame": 8}])
    send("edits", action="remove", remove=[second["segment_id"]])
    assert len(held) == 2
    for _ in range(3):
        send("undo")
    assert held == {}
    for _ in range(3):
        send("redo")
    assert {row["start_frame"]: row["end_frame"] for row in held.values()} == {0: 8, 20: 25}


def test_a_stale_write_is_refused_with_what_changed(api: TestClient) -> None:
    assert put(api).status_code == 200
    refused = put(api, based_on=0, start_frame=20, end_frame=30)
    assert refused.status_code == 409
    assert refused.json()["changes"][0]["action"] == "mark"
    assert len(api.get("/api/episodes/episode/rows").json()["segments"]) == 1


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"end_frame": 60}, "has frames 0 to 59"),
        ({"start_frame": -1}, "has frames 0 to 59"),
        ({"start_frame": 9, "end_frame": 3}, "does not fit"),
        ({"start_frame": 1.5}, "must be a int"),
        ({"start_frame": True}, "must be a int"),
        ({"itc_id": "no/such"}, "has no ITC 'no/such'"),
        ({"reward": 2}, "reward is 2"),
        ({"reward": "1"}, "reward is '1'"),
        ({"rationale": 3}, "must be a str"),
    ],
)
def test_an_edit_that_makes_no_sense_is_refused(api: TestClient, fields: dict, said: str) -> None:
    answer = put(api, **fields)
    assert answer.status_code == 400
    assert said in answer.json()["error"]
    assert api.get("/api/episodes/episode/rows").json()["version"] == 0


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b'{"action": "x"}', b'{"action": "x", "based_on": "0"}'])
def test_a_request_of_another_shape_is_refused(api: TestClient, body: bytes) -> None:
    answer = api.post("/api/episodes/episode/edits", content=body)
    assert answer.status_code == 400
    assert answer.json()["error"]


def test_a_huge_request_is_refused(api: TestClient) -> None:
    assert api.post("/api/episodes/episode/edits", content=b" " * (2 << 20)).status_code == 413


@pytest.mark.parametrize("name", ["nothing", "..%2F..%2Fetc%2Fpasswd", "%2Fetc%2Fpasswd"])
def test_nothing_outside_the_source_is_served(api: TestClient, folder: Path, name: str) -> None:
    for path in (f"/api/episodes/{name}", f"/api/episodes/{name}/recording.rrd", f"/static/{name}", f"/rerun/{name}"):
        answer = api.get(path)
        assert answer.status_code == 404
        assert "root:" not in answer.text


def test_text_of_users_stays_text(api: TestClient) -> None:
    note = "<script>alert(1)</script>"
    assert put(api, rationale=note).json()["changed"][0]["rationale"] == note
    assert api.get("/api/episodes/episode/rows").headers["content-type"] == "application/json"


def test_the_recording_is_an_rrd(api: TestClient) -> None:
    body = api.get("/api/episodes/episode/recording.rrd").content
    assert body[:4] == b"RRF2"
    assert len(body) > 10_000


def test_a_broken_recording_is_listed_and_the_rest_opens(client: Client, session: Session, folder: Path) -> None:
    (folder / "broken.mcap").write_bytes(b"not a recording")
    from jiti.annotate.web.session import open_session

    api = client(open_session(str(folder), annotator="ada", labels=None, tasks=None))
    rows = {row["episode_id"]: row for row in api.get("/api/episodes").json()["episodes"]}
    assert set(rows) == {"broken", "episode", "other"}
    answer = api.get("/api/episodes/broken")
    assert answer.status_code == 404
    assert "broken.mcap" in answer.json()["error"]
    assert api.get("/api/episodes/other").status_code == 200


def test_keys_are_kept_in_the_settings(api: TestClient) -> None:
    assert api.get("/api/keys").json() == {"keys": {}}
    assert api.put("/api/keys", json={"keys": {"window": "g"}}).status_code == 200
    assert api.get("/api/keys").json() == {"keys": {"window": "g"}}
    assert api.put("/api/keys", json={"keys": {"window": 3}}).status_code == 400


def test_a_disk_that_refuses_is_said_and_loses_nothing(api: TestClient, folder: Path) -> None:
    assert put(api).status_code == 200
    segments = folder / "labels" / "segments" / "annotator=ada" / "episode.parquet"
    before = segments.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, limits[1]))  # every write fails, as on a full disk
    try:
        answer = put(api, based_on=1, start_frame=20, end_frame=30)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert answer.status_code == 507
    assert "episode.jsonl" in answer.json()["error"]
    assert segments.read_bytes() == before
    assert put(api, based_on=1, start_frame=20, end_frame=30).json()["version"] == 2
