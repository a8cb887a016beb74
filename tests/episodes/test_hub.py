"""LeRobot datasets by their id on the Hub, without a network."""

import hashlib
import json
import shutil
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from jiti.episodes.hub import find_dataset, hub_cache, is_repo_id, lerobot_home
from jiti.errors import SourceError
from tests.builders.lerobot import write_v3

REPO = "user/cups"
COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("HF_LEROBOT_HOME", "HF_HUB_CACHE", "HUGGINGFACE_HUB_CACHE", "HF_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "hf"


def snapshot(cache: Path, revision: str = "main") -> Path:
    """A dataset as huggingface_hub lays out its cache: links to a store of blobs."""
    repo = cache / "datasets--user--cups"
    folder = write_v3(repo / "snapshots" / COMMIT, (3, 4))
    for path in [p for p in folder.rglob("*") if p.is_file()]:
        blob = repo / "blobs" / f"{abs(hash(path)):x}"
        blob.parent.mkdir(exist_ok=True)
        shutil.move(path, blob)
        path.symlink_to(blob)
    (repo / "refs").mkdir(parents=True)
    (repo / "refs" / revision).write_text(COMMIT)
    return folder


def test_lerobots_own_folder_comes_first(caches: Path) -> None:
    snapshot(caches / "hub")
    root = write_v3(caches / "lerobot" / REPO, (2,))
    assert find_dataset(REPO) == root


def test_lerobots_folder_may_lie_elsewhere(caches: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "robots"))
    root = write_v3(tmp_path / "robots" / REPO, (2,))
    assert find_dataset(REPO) == root
    assert lerobot_home() == tmp_path / "robots"


@pytest.mark.parametrize("place", ["hub", "lerobot/hub"])
@pytest.mark.parametrize("revision", ["main", "v3.0", "v2.1"])
def test_snapshots_in_the_caches_are_found(caches: Path, place: str, revision: str) -> None:
    from jiti.episodes.reader import open_reader

    folder = snapshot(caches / place, revision)
    assert find_dataset(REPO).resolve() == folder.resolve()
    episode = open_reader(REPO).open("episode_000001")
    assert episode.problems == []
    assert sum(len(batch.time_ns) for batch in episode.read(["observation.images.front"])) == 4


def test_the_cache_may_lie_elsewhere(caches: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "else"))
    assert hub_cache() == tmp_path / "else"
    folder = snapshot(tmp_path / "else")
    assert find_dataset(REPO).resolve() == folder.resolve()


def test_without_a_network_the_error_says_where_it_looked(caches: Path) -> None:
    with pytest.raises(SourceError) as caught:
        find_dataset(REPO)
    message = str(caught.value)
    assert message.startswith("user/cups: no such file or folder, and no such dataset on this machine. Looked in: ")
    for place in (caches / "lerobot" / REPO, caches / "lerobot" / "hub", caches / "hub"):
        assert str(place) in message
    assert "HF_HUB_OFFLINE is set: unset it to download the dataset, or give the path of a folder." in message


def test_a_copy_of_the_metadata_alone_is_not_taken(caches: Path) -> None:
    folder = snapshot(caches / "hub")
    shutil.rmtree(folder / "data")
    with pytest.raises(SourceError, match=r"The copy in .* has no data files"):
        find_dataset(REPO)


def test_a_complete_copy_comes_before_an_incomplete_one(caches: Path) -> None:
    shutil.rmtree(write_v3(caches / "lerobot" / REPO, (2,)) / "data")
    folder = snapshot(caches / "hub")
    assert find_dataset(REPO).resolve() == folder.resolve()


def go_online(monkeypatch: pytest.MonkeyPatch, endpoint: str) -> None:
    import huggingface_hub.constants

    monkeypatch.delenv("HF_HUB_OFFLINE")
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(huggingface_hub.constants, "ENDPOINT", endpoint)
    files = f"{endpoint}/{{repo_id}}/resolve/{{revision}}/{{filename}}"
    monkeypatch.setattr(huggingface_hub.constants, "HUGGINGFACE_CO_URL_TEMPLATE", files)


@pytest.fixture
def hub() -> Iterator[type["Hub"]]:
    """A Hub on this machine."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Hub)
    Hub.endpoint = f"http://127.0.0.1:{server.server_port}"
    Hub.answer, Hub.root = (200, ""), None
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield Hub
    server.shutdown()
    thread.join()
    server.server_close()


class Hub(BaseHTTPRequestHandler):
    """Answers as the Hub does: the files of `root`, or an error with its code."""

    endpoint: str
    answer: tuple[int, str]
    root: Path | None

    def do_GET(self) -> None:
        self._send(with_body=True)

    def do_HEAD(self) -> None:
        self._send(with_body=False)

    def log_message(self, format: str, *args: object) -> None:
        pass

    def _send(self, *, with_body: bool) -> None:
        status, code = self.answer
        body = b"{}"
        path = self.path.partition("?")[0]
        if self.root is not None:
            files = sorted(p.relative_to(self.root).as_posix() for p in self.root.rglob("*") if p.is_file())
            if path.startswith("/api/"):
                entries = [
                    {"type": "file", "path": f, "size": (self.root / f).stat().st_size, "oid": "0" * 40} for f in files
                ]
                listing = {"id": REPO, "sha": COMMIT, "siblings": [{"rfilename": f} for f in files]}
                body = json.dumps(entries if "/tree/" in path else listing).encode()
            else:
                body = (self.root / path.partition(f"/resolve/{COMMIT}/")[2]).read_bytes()
        self.send_response(status)
        if code:
            self.send_header("X-Error-Code", code)
        self.send_header("X-Repo-Commit", COMMIT)
        self.send_header("ETag", f'"{hashlib.sha1(body).hexdigest()}"')
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if with_body:
            self.wfile.write(body)


def test_a_dataset_is_downloaded_once(
    caches: Path, hub: type[Hub], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    hub.root = write_v3(tmp_path / "remote", (3, 4))
    go_online(monkeypatch, hub.endpoint)
    folder = find_dataset(REPO)
    assert (folder / "meta/info.json").read_bytes() == (hub.root / "meta/info.json").read_bytes()
    assert "hf_secret" not in "".join(capfd.readouterr())
    hub.answer, hub.root = (500, ""), None
    assert find_dataset(REPO) == folder


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ((404, "RepoNotFound"), "no such dataset on the Hub. Looked in"),
        ((401, "RepoNotFound"), "for a private dataset run `hf auth login`"),
        ((403, "GatedRepo"), "access to this dataset must be granted on the Hub"),
        ((400, ""), "the download failed ("),
    ],
)
def test_what_the_hub_refuses_is_said(
    caches: Path,
    hub: type[Hub],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    answer: tuple[int, str],
    message: str,
) -> None:
    hub.answer = answer
    go_online(monkeypatch, hub.endpoint)
    with pytest.raises(SourceError) as caught:
        find_dataset(REPO)
    assert message in str(caught.value)
    assert str(caches / "lerobot" / REPO) in str(caught.value)
    assert "hf_secret" not in str(caught.value) + "".join(capfd.readouterr())


def test_a_hub_that_cannot_be_reached_is_an_error_of_ours(
    caches: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The address is one on this machine where nothing listens."""
    go_online(monkeypatch, "http://127.0.0.1:9")
    with pytest.raises(SourceError) as caught:
        find_dataset(REPO)
    message = str(caught.value)
    assert message.startswith("user/cups: no such file or folder, and the Hub cannot be reached. Looked in: ")
    assert "Connect to the network, or give the path of a folder." in message
    assert "hf_secret" not in message + "".join(capfd.readouterr())


def test_what_is_no_robot_dataset_is_said(
    caches: Path, hub: type[Hub], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub.root = tmp_path / "remote"
    hub.root.mkdir()
    (hub.root / "README.md").write_text("texts")
    go_online(monkeypatch, hub.endpoint)
    with pytest.raises(SourceError, match=r"is not a LeRobot dataset: it has no meta/info\.json"):
        find_dataset(REPO)


@pytest.mark.parametrize(
    ("source", "is_one"),
    [
        ("user/cups", True),
        ("lerobot/aloha_sim-transfer.v2", True),
        ("cups", False),
        ("a/b/c", False),
        ("/user/cups", False),
        ("./user/cups", False),
        ("../cups", False),
        ("~/cups", False),
        ("user/cups.mcap", False),
        ("user/..", False),
        ("user/", False),
        ("us er/cups", False),
        ("user/cups\n", False),
        ("", False),
    ],
)
def test_what_can_be_an_id(caches: Path, source: str, is_one: bool) -> None:
    assert is_repo_id(source) == is_one


def test_a_folder_that_is_here_makes_it_a_path(caches: Path) -> None:
    assert is_repo_id("demos/cups")
    Path("demos").mkdir()
    assert not is_repo_id("demos/cups")
