"""What every reader promises, whatever it reads."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jiti.episodes.episode import EpisodeReader, ImageBatch, NumericBatch
from jiti.episodes.reader import open_reader
from jiti.episodes.video import decode_frames
from jiti.errors import SourceError
from tests.builders.lerobot import AV1, FRONT, IMAGES, MPEG4, WRIST, write_v3, write_v21
from tests.builders.mcap import Camera, write_mcap
from tests.builders.pictures import read_number

TWO = (FRONT, WRIST)


def mcap_file(folder: Path, **options: Any) -> Path:
    cameras = {
        "/front": Camera(width=160, height=120),
        "/wrist": Camera(width=160, height=120, rate_hz=15, image="h264"),
    }
    return write_mcap(folder / "pick.mcap", cameras=cameras, duration_s=1.0, instruction="Pick.", **options).path


def mcap_folder(folder: Path) -> Path:
    mcap_file(folder)
    mcap_file(folder, chunked=False).rename(folder / "second.mcap")
    return folder


SOURCES: dict[str, Callable[[Path], Path]] = {
    "mcap file": mcap_file,
    "mcap without an index": lambda folder: mcap_file(folder, summary=False),
    "folder": mcap_folder,
    "lerobot v3": lambda folder: write_v3(folder / "d", (12, 9), cameras=TWO),
    "lerobot v3, av1": lambda folder: write_v3(folder / "d", (12, 9), cameras=TWO, encoder=AV1),
    "lerobot v3, encoded anew": lambda folder: write_v3(folder / "d", (12, 9), cameras=TWO, encoder=MPEG4),
    "lerobot v3, pictures": lambda folder: write_v3(folder / "d", (12, 9), cameras=TWO, encoder=IMAGES),
    "lerobot v2.1": lambda folder: write_v21(folder / "d", (12, 9), cameras=TWO),
}


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "source").mkdir()
    return SOURCES[request.param](tmp_path / "source")


@pytest.fixture
def reader(source: Path) -> EpisodeReader:
    return open_reader(source)


def test_a_source_says_what_it_is(reader: EpisodeReader, source: Path) -> None:
    assert reader.title
    assert Path(reader.labels_dir).is_absolute()
    assert source.parent.parent in Path(reader.labels_dir).parents
    assert list(reader.problems) == []


def test_the_listing_is_stable_and_its_ids_are_file_names(reader: EpisodeReader, source: Path) -> None:
    ids = [ref.episode_id for ref in reader.episodes()]
    assert ids
    assert len(set(ids)) == len(ids)
    assert ids == [ref.episode_id for ref in open_reader(source).episodes()]
    for episode_id in ids:
        assert "/" not in episode_id
        assert not episode_id.startswith(".")


def test_the_listing_agrees_with_the_episodes(reader: EpisodeReader) -> None:
    for ref in reader.episodes():
        episode = reader.open(ref.episode_id)
        assert episode.episode_id == ref.episode_id
        assert ref.frame_count in (None, episode.clock.frame_count)
        assert ref.task in (None, episode.task)
        assert episode.task in ("Pick.", "Pick up the red cup.")
        assert list(episode.problems) == []


def test_batches_hold_what_the_streams_promise(reader: EpisodeReader) -> None:
    for ref in reader.episodes():
        episode = reader.open(ref.episode_id)
        times: dict[str, list[np.ndarray]] = {}
        size = 0
        for batch in episode.read():
            stream = episode.streams[batch.stream]
            times.setdefault(batch.stream, []).append(batch.time_ns)
            assert len(batch.time_ns) > 0
            assert batch.time_ns.dtype == np.int64
            if isinstance(batch, ImageBatch):
                assert stream.kind in ("camera", "depth")
                assert batch.encoding == stream.encoding
                assert len(batch.data) == len(batch.time_ns)
                size += sum(map(len, batch.data))
            else:
                assert isinstance(batch, NumericBatch)
                assert stream.kind == "numeric"
                assert batch.values.dtype == np.float64
                assert batch.values.shape == (len(batch.time_ns), *stream.shape)
                assert stream.names == () or len(stream.names) == stream.shape[0]
        assert set(times) == {s.name for s in episode.streams.values() if s.kind != "other"}
        for name, parts in times.items():
            together = np.concatenate(parts)
            assert len(together) == episode.streams[name].count
            assert (np.diff(together) >= 0).all()
        assert 0 < size <= episode.image_bytes


def test_the_clock_is_the_first_camera(reader: EpisodeReader) -> None:
    for ref in reader.episodes():
        episode = reader.open(ref.episode_id)
        first = next(s for s in episode.streams.values() if s.kind == "camera")
        assert episode.clock.reference == first.name
        times = np.concatenate([batch.time_ns for batch in episode.read([first.name])])
        assert times.tolist() == episode.clock.frame_ns.tolist()
        assert episode.clock.rate_hz == pytest.approx(30, rel=1e-3)


def test_a_frame_shows_its_own_picture(reader: EpisodeReader) -> None:
    for ref in reader.episodes():
        episode = reader.open(ref.episode_id)
        last = episode.clock.frame_count - 1
        pictures = dict(decode_frames(episode, episode.clock.reference or "", [0, 3, last]))
        assert {frame: read_number(picture) for frame, picture in pictures.items()} == {0: 0, 3: 3, last: last}


def test_reading_again_and_in_part_gives_the_same(reader: EpisodeReader) -> None:
    episode = reader.open(reader.episodes()[0].episode_id)
    whole = {name: [b for b in episode.read() if b.stream == name] for name in episode.streams}
    for name, stream in episode.streams.items():
        if stream.kind == "other":
            continue
        part = list(episode.read([name]))
        assert {b.stream for b in part} == {name}
        assert (
            np.concatenate([b.time_ns for b in part]).tolist()
            == np.concatenate([b.time_ns for b in whole[name]]).tolist()
        )
    early = episode.read()
    next(iter(early))
    assert len(list(episode.read())) == len(list(episode.read()))


def test_wrong_names_are_answered_with_those_that_are_there(reader: EpisodeReader) -> None:
    episode = reader.open(reader.episodes()[0].episode_id)
    with pytest.raises(SourceError, match="/nothing") as caught:
        list(episode.read(["/nothing"]))
    assert next(iter(episode.streams)) in str(caught.value)
    with pytest.raises(SourceError, match="no-such-episode") as caught:
        reader.open("no-such-episode")
    assert reader.episodes()[0].episode_id in str(caught.value)


def test_the_fingerprint_is_of_the_recording(reader: EpisodeReader, source: Path) -> None:
    refs = reader.episodes()
    prints = [reader.open(ref.episode_id).fingerprint for ref in refs]
    assert prints == [open_reader(source).open(ref.episode_id).fingerprint for ref in refs]
    assert len(set(prints)) == len(prints)
