"""Single pictures by frame, without a pass over the recording."""

from pathlib import Path

import numpy as np
import pytest

from jiti.episodes import video
from jiti.episodes.mcap_episode import McapEpisode
from jiti.errors import SourceError
from tests.builders import mcap_messages
from tests.builders.encode import encode_numbered
from tests.builders.mcap import START_NS, Camera, Channel, Message, write_mcap, write_messages
from tests.builders.pictures import read_number


@pytest.mark.parametrize("image", ["jpeg", "png", "raw", "h264"])
def test_each_frame_is_the_same_as_by_a_pass(tmp_path: Path, image: str) -> None:
    times_s = [0.0, 0.1, 0.1, 0.1, 0.5, 0.51, 1.2]
    cameras = {"/front": Camera(image), "/side": Camera(image, times_s=times_s, width=160, height=120)}
    episode = McapEpisode(write_mcap(tmp_path / "a.mcap", cameras=cameras, chunk_size=20_000).path, "a")
    assert (episode.decode("/side", [1]) is None) == (image == "h264")
    frames = [0, 3, 4, 5, 17, 30, 59]
    for stream in cameras:
        direct = {f: read_number(p) for f, p in video.decode_frames(episode, stream, frames)}
        passed = {f: read_number(p.to_ndarray(format="rgb24")) for f, p in video._through_read(episode, stream, frames)}
        assert direct == passed
        assert list(direct) == frames


def test_of_frames_with_one_time_the_first_shows_the_first(tmp_path: Path) -> None:
    cameras = {"/front": Camera(times_s=[0.0, 0.1, 0.1, 0.1, 0.2])}
    episode = McapEpisode(write_mcap(tmp_path / "a.mcap", cameras=cameras).path, "a")
    assert [(f, read_number(p)) for f, p in video.decode_frames(episode, "/front", range(5))] == [
        (k, k) for k in range(5)
    ]


def test_a_picture_that_cannot_be_used_shows_the_one_before(tmp_path: Path) -> None:
    pictures = encode_numbered(range(4), "jpeg")
    schema = mcap_messages.json_schema("foxglove.CompressedImage")
    data = [pictures[0], pictures[1], b"nonsense", pictures[3]]
    payloads = [mcap_messages.picture("json", "jpeg", 320, 240, 0, d)[1] for d in data]
    messages = [Message("/cam", START_NS + k * 10**8, payload) for k, payload in enumerate(payloads)]
    write_messages(tmp_path / "a.mcap", {"/cam": Channel(schema, "json")}, messages)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    assert [(f, read_number(p)) for f, p in video.decode_frames(episode, "/cam", range(4))] == [
        (0, 0),
        (1, 1),
        (2, 1),
        (3, 3),
    ]


def test_a_picture_that_does_not_decode_is_named(tmp_path: Path) -> None:
    whole = encode_numbered([0], "jpeg")[0]
    schema = mcap_messages.json_schema("foxglove.CompressedImage")
    payloads = [mcap_messages.picture("json", "jpeg", 320, 240, 0, d)[1] for d in (whole, whole[: len(whole) // 3])]
    messages = [Message("/cam", START_NS + k * 10**8, payload) for k, payload in enumerate(payloads)]
    write_messages(tmp_path / "a.mcap", {"/cam": Channel(schema, "json")}, messages)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    with pytest.raises(SourceError, match=r"a\.mcap, /cam, frame 1: the picture cannot be decoded: "):
        list(video.decode_frames(episode, "/cam", [0, 1]))


def test_no_more_is_read_than_the_chunks_that_are_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from jiti.episodes import mcap_frames

    episode = McapEpisode(write_mcap(tmp_path / "a.mcap", chunk_size=20_000).path, "a")
    unpacked = []
    unpack = mcap_frames.unpack
    monkeypatch.setattr(mcap_frames, "unpack", lambda file, chunk: unpacked.append(chunk.number) or unpack(file, chunk))
    found = {f: read_number(p) for f, p in video.decode_frames(episode, "/camera/front", [3, 50, 51])}
    assert found == {3: 3, 50: 50, 51: 51}
    assert len(unpacked) <= 3
    assert len(np.unique(unpacked)) == len(unpacked)
