"""The lighter copy of a camera stream."""

import threading
from fractions import Fraction
from typing import Any

import av
import numpy as np
import pytest

from jiti.episodes.episode import PictureFormat
from jiti.episodes.keyframes import is_key_frame
from jiti.episodes.transcode import transcode
from jiti.episodes.video import decode_frames
from jiti.episodes.video_decode import SampleDecoder, to_rgb
from jiti.errors import SourceError
from tests.builders.camera_episode import CAMERA, CameraEpisode, at_30_hz
from tests.builders.encode import VIDEO_CODECS, encode_numbered
from tests.builders.lerobot import png
from tests.builders.pictures import read_number


def still(picture: np.ndarray, encoding: str) -> bytes:
    """One RGB picture (height, width, 3) as `png`, `jpeg` or `raw` rows."""
    if encoding == "raw":
        return np.ascontiguousarray(picture).tobytes()
    if encoding == "png":
        return png(np.ascontiguousarray(picture))
    codec: Any = av.CodecContext.create("mjpeg", "w")
    codec.height, codec.width = picture.shape[:2]
    codec.pix_fmt, codec.time_base = "yuvj420p", Fraction(1, 30)
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "rgb24").reformat(
        format="yuvj420p", dst_color_range="JPEG"
    )
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])


def decoded(samples: list[bytes]) -> list[np.ndarray]:
    decoder = SampleDecoder("h264")
    return [to_rgb(f) for i, s in enumerate(samples) for _, f in decoder.decode(s, i)] + [
        to_rgb(f) for _, f in decoder.flush()
    ]


@pytest.mark.parametrize("encoding", ["jpeg", "png", "raw", *VIDEO_CODECS])
def test_every_picture_keeps_its_time_and_its_number(encoding: str) -> None:
    raw = PictureFormat(320, 240, "rgb8", 960) if encoding == "raw" else None
    times = np.cumsum(np.random.default_rng(3).integers(0, 90_000_000, 70))
    episode = CameraEpisode(encode_numbered(range(70), encoding, gop=20), encoding, times, raw=raw)

    batches = list(transcode(episode, CAMERA, max_height=120))
    samples = [sample for batch in batches for sample in batch.data]
    pictures = decoded(samples)

    assert [read_number(picture) for picture in pictures] == list(range(70))
    assert {picture.shape for picture in pictures} == {(120, 160, 3)}
    assert np.concatenate([batch.time_ns for batch in batches]).tolist() == times.tolist()
    assert {batch.encoding for batch in batches} == {"h264"}
    assert [i for i, sample in enumerate(samples) if is_key_frame("h264", sample)][:2] == [0, 30]


def test_a_picture_is_never_enlarged() -> None:
    episode = CameraEpisode(encode_numbered(range(3), "jpeg", 161, 121), "jpeg", at_30_hz(3))
    (batch,) = transcode(episode, CAMERA, max_height=1080)
    assert {picture.shape for picture in decoded(list(batch.data))} == {(120, 160, 3)}


@pytest.mark.parametrize("encoding", ["jpeg", "png"])
def test_what_does_not_decode_is_left_out_and_counted(encoding: str) -> None:
    data = encode_numbered(range(20), encoding)
    data[3], data[9] = data[3][:300], b""
    copy = transcode(CameraEpisode(data, encoding, at_30_hz(20)), CAMERA, max_height=120)
    batches = list(copy)
    kept = [i for i in range(20) if i not in (3, 9)]
    assert [read_number(p) for p in decoded([s for b in batches for s in b.data])] == kept
    assert np.concatenate([b.time_ns for b in batches]).tolist() == at_30_hz(20)[kept].tolist()
    assert copy.left_out == 2
    assert copy.first_reason


def test_video_before_its_first_key_frame_is_left_out() -> None:
    data = encode_numbered(range(30), "h264", gop=10)[4:]
    copy = transcode(CameraEpisode(data, "h264", at_30_hz(26)), CAMERA, max_height=240)
    batches = list(copy)
    assert [read_number(p) for p in decoded([s for b in batches for s in b.data])] == list(range(10, 30))
    assert batches[0].time_ns[0] == at_30_hz(26)[6]
    assert copy.left_out == 6


def test_it_reads_no_faster_than_it_is_read_and_stops_when_closed() -> None:
    episode = CameraEpisode(encode_numbered(range(500), "jpeg", 64, 48), "jpeg", at_30_hz(500), batch_size=10)
    copy = transcode(episode, CAMERA, max_height=48)
    next(copy)
    assert episode.yielded < 100
    copy.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("transcode")]


def test_it_needs_a_camera() -> None:
    episode = CameraEpisode([], "jpeg", at_30_hz(0))
    with pytest.raises(SourceError, match=r"memory has no camera '/wrist'; it has: /camera\."):
        transcode(episode, "/wrist", max_height=240)
    assert list(transcode(episode, CAMERA, max_height=240)) == []


@pytest.mark.parametrize("encoding", ["png", "jpeg", "raw"])
def test_colours_stay(encoding: str) -> None:
    colour = np.array([200, 30, 90], np.uint8)
    picture = np.broadcast_to(colour, (48, 64, 3))
    raw = PictureFormat(64, 48, "rgb8", 192) if encoding == "raw" else None
    episode = CameraEpisode([still(picture, encoding)] * 3, encoding, at_30_hz(3), raw=raw)
    (batch,) = transcode(episode, CAMERA, max_height=48)
    shown = decoded(list(batch.data))[2]
    assert np.abs(shown.astype(int) - colour).max() <= 6
    (_, direct), *_ = decode_frames(episode, CAMERA, [0])
    assert np.abs(direct.astype(int) - colour).max() <= 4
