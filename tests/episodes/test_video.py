"""Pictures of any episode by frame number, from any encoding."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.episodes.episode import PictureFormat
from jiti.episodes.keyframes import is_key_frame, obu_types
from jiti.episodes.video import decode_frames
from jiti.episodes.video_decode import UndecodablePicture, raw_frame, to_rgb
from jiti.episodes.video_encode import H264Encoder, max_encoded_bytes
from jiti.errors import SourceError
from tests.builders.camera_episode import CAMERA, CameraEpisode, at_30_hz
from tests.builders.encode import VIDEO_CODECS, encode_numbered
from tests.builders.pictures import read_number


@pytest.mark.parametrize("encoding", ["jpeg", "png", "raw", *VIDEO_CODECS])
def test_any_encoding_decodes_to_the_right_frames(encoding: str) -> None:
    raw = PictureFormat(160, 120, "rgb8", 480) if encoding == "raw" else None
    episode = CameraEpisode(encode_numbered(range(30), encoding, 160, 120, gop=10), encoding, at_30_hz(30), raw=raw)
    shown = list(decode_frames(episode, CAMERA, [29, 0, 5, 14, 5]))
    assert [(frame, read_number(picture)) for frame, picture in shown] == [(0, 0), (5, 5), (14, 14), (29, 29)]
    assert shown[0][1].shape == (120, 160, 3)
    assert shown[0][1].dtype == np.uint8


@pytest.mark.parametrize("encoding", ["jpeg", "h264"])
@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_a_frame_shows_the_latest_picture_at_or_before_it(encoding: str, data: st.DataObject) -> None:
    steps = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=12))
    times = np.cumsum(steps).astype(np.int64)
    frame_ns = np.sort(np.array(data.draw(st.lists(st.integers(0, 30), min_size=1, max_size=8)), np.int64))
    wanted = data.draw(st.lists(st.integers(0, len(frame_ns) - 1), max_size=6))
    episode = CameraEpisode(encode_numbered(range(len(times)), encoding, 64, 48, gop=4), encoding, times, frame_ns)

    def expected(frame: int) -> int | None:
        """Frames that share a time take the pictures that share it one after the other."""
        at = frame_ns[frame]
        equal = np.flatnonzero(times == at)
        if len(equal):
            return int(equal[min(frame - np.searchsorted(frame_ns, at), len(equal) - 1)])
        before = np.flatnonzero(times < at)
        return int(before[-1]) if len(before) else None

    shown = {frame: read_number(picture) for frame, picture in decode_frames(episode, CAMERA, wanted)}
    assert shown == {f: expected(f) for f in set(wanted) if expected(f) is not None}


def test_reading_stops_after_the_last_wanted_frame() -> None:
    episode = CameraEpisode(encode_numbered(range(100), "jpeg", 64, 48), "jpeg", at_30_hz(100), batch_size=5)
    assert [frame for frame, _ in decode_frames(episode, CAMERA, [3])] == [3]
    assert episode.yielded == 5


@pytest.mark.parametrize("encoding", ["jpeg", "png", "h264"])
def test_a_picture_that_does_not_decode_names_its_stream_and_frame(encoding: str) -> None:
    data = encode_numbered(range(10), encoding, 64, 48, gop=5)
    data[6] = data[6][: len(data[6]) // 2] if encoding != "h264" else b"\0\0\0\1\x65garbage"
    episode = CameraEpisode(data, encoding, at_30_hz(10))
    assert [f for f, _ in decode_frames(episode, CAMERA, [0, 5])] == [0, 5]
    with pytest.raises(SourceError, match="memory, /camera, frame 6: the picture cannot be decoded"):
        list(decode_frames(episode, CAMERA, [5, 6]))


def test_a_long_stretch_without_key_frames_is_decoded_before_it_fills_the_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = encode_numbered(range(60), "h264", 64, 48, gop=1000)
    monkeypatch.setattr("jiti.episodes.video.MAX_HELD_BYTES", sum(map(len, data)) // 4)
    episode = CameraEpisode(data, "h264", at_30_hz(60))
    assert [(f, read_number(p)) for f, p in decode_frames(episode, CAMERA, [58])] == [(58, 58)]


def test_video_before_its_first_key_frame_cannot_be_shown() -> None:
    data = encode_numbered(range(20), "h264", 64, 48, gop=10)[5:]
    episode = CameraEpisode(data, "h264", at_30_hz(15))
    assert [read_number(p) for _, p in decode_frames(episode, CAMERA, [5, 9])] == [10, 14]
    with pytest.raises(SourceError, match="frame 2: the picture cannot be decoded"):
        list(decode_frames(episode, CAMERA, [2, 9]))


def test_wrong_names_and_numbers_are_answered_with_what_there_is() -> None:
    episode = CameraEpisode(encode_numbered(range(3), "jpeg", 64, 48), "jpeg", at_30_hz(3))
    with pytest.raises(SourceError, match=r"memory has no camera '/wrist'; it has: /camera\."):
        list(decode_frames(episode, "/wrist", [0]))
    for frame in (3, -1):
        with pytest.raises(SourceError, match=rf"memory has no frame {frame}; it has 0 to 2\."):
            list(decode_frames(episode, CAMERA, [0, frame]))


# Raw pixels


@pytest.mark.parametrize(
    ("pixel_format", "channels"), [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2]), ("bgra8", [2, 1, 0])]
)
@given(width=st.integers(1, 40), height=st.integers(1, 20), padding=st.integers(0, 9), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=25)
def test_raw_colours_survive_any_size_and_row_padding(
    pixel_format: str, channels: list[int], width: int, height: int, padding: int, seed: int
) -> None:
    picture = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    pixels = picture[..., channels]
    if "a" in pixel_format:
        pixels = np.concatenate([pixels, np.full((height, width, 1), 255, np.uint8)], 2)
    rows = pixels.reshape(height, -1)
    stride = rows.shape[1] + padding
    data = np.pad(rows, ((0, 0), (0, padding))).tobytes()
    assert np.array_equal(to_rgb(raw_frame(data, PictureFormat(width, height, pixel_format, stride))), picture)


def test_depth_is_shown_as_grey_from_near_to_far() -> None:
    depth = np.array([[0, 500], [1000, 1500]], "<u2")
    grey = to_rgb(raw_frame(depth.tobytes(), PictureFormat(2, 2, "16UC1", 4)))
    assert grey[..., 0].tolist() == [[0, 0], [127, 255]]
    metres = np.array([[np.nan, 0.5], [1.0, 1.5]], "<f4")
    grey = to_rgb(raw_frame(metres.tobytes(), PictureFormat(2, 2, "32FC1", 8)))
    assert grey[..., 0].tolist() == [[0, 0], [127, 255]]


def test_grey_and_bayer_decode() -> None:
    mono = np.arange(64, dtype=np.uint8).reshape(8, 8)
    assert (
        np.abs(to_rgb(raw_frame(mono.tobytes(), PictureFormat(8, 8, "mono8", 8)))[..., 0].astype(int) - mono).max() < 2
    )
    red = np.zeros((8, 8), np.uint8)
    red[::2, ::2] = 255
    picture = to_rgb(raw_frame(red.tobytes(), PictureFormat(8, 8, "bayer_rggb8", 8)))
    assert picture[2:6, 2:6, 0].mean() > 200
    assert picture[2:6, 2:6, 1:].mean() < 20


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        (PictureFormat(4, 4, "rgb8", 12), "it has 10 bytes; 4 rows of 12 bytes are declared"),
        (PictureFormat(30_000, 30_000, "rgb8", 90_000), "it declares 30000x30000 pixels"),
        (PictureFormat(1, 1, "nv99", 3), "its pixel format 'nv99' is not one of rgb8"),
        (PictureFormat(4, 1, "rgb8", 4), "its rows have 4 bytes; 4 pixels of rgb8 need 12"),
    ],
)
def test_raw_pictures_that_lie_about_their_size_are_refused(layout: PictureFormat, message: str) -> None:
    with pytest.raises(UndecodablePicture, match=message):
        raw_frame(bytes(10), layout)


# Samples


@pytest.mark.parametrize("encoding", VIDEO_CODECS)
def test_key_frames_are_told_from_the_bytes(encoding: str) -> None:
    samples = encode_numbered(range(25), encoding, 64, 48, gop=10)
    assert [i for i, s in enumerate(samples) if is_key_frame(encoding, s)] == [0, 10, 20]


@given(st.binary(max_size=60), st.sampled_from([*VIDEO_CODECS, "jpeg"]))
def test_no_bytes_break_the_search_for_key_frames(data: bytes, encoding: str) -> None:
    assert is_key_frame(encoding, data) in (True, False)
    assert len(list(obu_types(data))) <= len(data)


def test_each_picture_gives_one_sample_and_the_ceiling_holds() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (60, 96, 128, 3), np.uint8)
    encoder = H264Encoder(128, 96, 30.0)
    samples = [encoder.encode(raw_frame(p.tobytes(), PictureFormat(128, 96, "rgb8", 384))) for p in noise]
    assert [i for i, s in enumerate(samples) if is_key_frame("h264", s)] == [0, 30]
    assert sum(map(len, samples)) <= max_encoded_bytes(128, 96, 60, 30.0)
