"""Clips of a video file: every sample shows its own frame."""

from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.keyframes import is_key_frame
from jiti.episodes.video_clip import Clip, decode_clip, read_clip, scan_clip
from jiti.episodes.video_decode import SampleDecoder, to_rgb
from jiti.errors import SourceError
from tests.builders import lerobot
from tests.builders.pictures import numbered, read_number

LENGTHS = (12, 9, 40)


def numbers_in(samples: list[bytes], encoding: str) -> list[int]:
    """What a viewer shows that is fed the samples one after the other, without a container."""
    decoder = SampleDecoder(encoding)
    frames = [out for index, sample in enumerate(samples) for out in decoder.decode(sample, index)]
    frames += decoder.flush()
    assert [index for index, _ in frames] == list(range(len(samples)))
    return [read_number(to_rgb(frame)) for _, frame in frames]


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One file a codec, with three episodes whose pictures count on through the file."""
    folder = tmp_path_factory.mktemp("videos")
    starts = np.cumsum([0, *LENGTHS])
    episodes = [[numbered(starts[e] + i, 160, 120) for i in range(n)] for e, n in enumerate(LENGTHS)]
    paths = {}
    for name, encoder in lerobot.ENCODERS.items():
        paths[name] = folder / f"{name}.mp4"
        lerobot.write_video(paths[name], episodes, encoder, 30)
    return paths


def clip_of(path: Path, episode: int = 0, **changes: object) -> Clip:
    start = sum(LENGTHS[:episode])
    fields = {"start_s": start / 30, "rate_hz": 30.0, "frame_count": LENGTHS[episode], **changes}
    return Clip(path, path.name, **fields)  # type: ignore[arg-type]


COPIED = {"h264", "h264_long_gop", "av1", "av1_long_gop"}


@pytest.mark.parametrize("episode", [0, 1, 2])
@pytest.mark.parametrize("codec", lerobot.ENCODERS)
def test_every_sample_of_a_clip_shows_its_own_frame(videos: dict[str, Path], codec: str, episode: int) -> None:
    clip = clip_of(videos[codec], episode)
    scan = scan_clip(clip)
    frame_ns = np.arange(clip.frame_count, dtype=np.int64) * 33_333_333
    batches = list(read_clip(clip, scan, "front", frame_ns))
    samples = [sample for batch in batches for sample in batch.data]
    start = sum(LENGTHS[:episode])

    assert scan.copied == (codec in COPIED)
    assert numbers_in(samples, scan.encoding) == list(range(start, start + clip.frame_count))
    assert np.concatenate([batch.time_ns for batch in batches]).tolist() == frame_ns.tolist()
    assert {batch.encoding for batch in batches} == {scan.encoding}
    assert is_key_frame(scan.encoding, samples[0])
    assert sum(map(len, samples)) <= scan.max_bytes
    assert scan.problems == ()


@pytest.mark.parametrize("codec", lerobot.ENCODERS)
def test_frames_are_decoded_straight_from_the_file(videos: dict[str, Path], codec: str) -> None:
    clip = clip_of(videos[codec], 2, rate_hz=30.0)
    wanted = [0, 1, 7, 30, 39]
    shown = {frame: read_number(to_rgb(picture)) for frame, picture in decode_clip(clip, wanted)}
    assert shown == {frame: 21 + frame for frame in wanted}


def test_far_frames_are_reached_by_a_seek(tmp_path: Path) -> None:
    path = tmp_path / "long.mp4"
    lerobot.write_video(path, [[numbered(i, 64, 48) for i in range(200)]], lerobot.H264, 10)
    clip = Clip(path, "long.mp4", 0.0, 10.0, 200)
    shown = {frame: read_number(to_rgb(picture)) for frame, picture in decode_clip(clip, [3, 100, 199])}
    assert shown == {3: 3, 100: 100, 199: 199}


def test_an_episode_that_does_not_begin_at_a_key_frame_is_encoded_anew(videos: dict[str, Path]) -> None:
    clip = clip_of(videos["h264_long_gop"], start_s=5 / 30, frame_count=4)
    scan = scan_clip(clip)
    samples = [s for batch in read_clip(clip, scan, "front", np.arange(4)) for s in batch.data]
    assert not scan.copied
    assert numbers_in(samples, "h264") == [5, 6, 7, 8]


def test_h264_samples_carry_their_parameter_sets_at_every_key_frame(videos: dict[str, Path]) -> None:
    clip = clip_of(videos["h264"], 2)
    samples = [s for b in read_clip(clip, scan_clip(clip), "front", np.arange(40)) for s in b.data]
    keys = [index for index, sample in enumerate(samples) if is_key_frame("h264", sample)]
    assert keys == [0, 10, 20, 30]
    for key in keys:
        assert numbers_in(samples[key : key + 10], "h264") == list(range(21 + key, 31 + key))


def test_odd_sizes_are_made_even(tmp_path: Path) -> None:
    path = tmp_path / "odd.mp4"
    odd = lerobot.Encoder("libx264", (("preset", "ultrafast"),), "yuv444p")
    lerobot.write_video(path, [[numbered(i, 161, 121) for i in range(5)]], odd, 30)
    clip = Clip(path, "odd.mp4", 0.0, 30.0, 5)
    scan = scan_clip(clip)
    samples = [s for b in read_clip(clip, scan, "front", np.arange(5)) for s in b.data]
    assert numbers_in(samples, "h264") == [0, 1, 2, 3, 4]


def test_a_short_video_leaves_its_last_frames_empty(videos: dict[str, Path]) -> None:
    clip = clip_of(videos["h264"], 2, frame_count=43)
    scan = scan_clip(clip)
    assert scan.frames.tolist() == list(range(40))
    assert "40 of 43 frames have a picture; the first without one is frame 40" in str(scan.problems[0])
    times = np.concatenate([b.time_ns for b in read_clip(clip, scan, "front", np.arange(43) * 5)])
    assert times.tolist() == [5 * frame for frame in range(40)]


@pytest.mark.parametrize("codec", ["h264", "mpeg4"])
def test_a_video_of_half_the_rate_never_shifts_frames(videos: dict[str, Path], codec: str) -> None:
    clip = clip_of(videos[codec], 0, rate_hz=60.0, frame_count=24)
    scan = scan_clip(clip)
    assert scan.frames.tolist() == list(range(0, 24, 2))
    assert "the dataset says 60 Hz, the video runs at 30 Hz" in str(scan.problems[0])
    batches = list(read_clip(clip, scan, "front", np.arange(24)))
    samples = [s for b in batches for s in b.data]
    assert numbers_in(samples, scan.encoding) == list(range(12))
    assert np.concatenate([b.time_ns for b in batches]).tolist() == list(range(0, 24, 2))


def test_of_two_pictures_in_one_frame_the_nearest_is_shown(videos: dict[str, Path]) -> None:
    clip = clip_of(videos["h264"], 0, rate_hz=15.0, frame_count=6)
    scan = scan_clip(clip)
    samples = [s for b in read_clip(clip, scan, "front", np.arange(6)) for s in b.data]
    assert scan.frames.tolist() == list(range(6))
    assert numbers_in(samples, "h264") == [0, 2, 4, 6, 8, 10]


def test_a_truncated_video_keeps_the_frames_that_are_there(videos: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "cut.mp4"
    whole = videos["h264"].read_bytes()
    path.write_bytes(whole[: len(whole) * 9 // 10])
    clip = clip_of(path, 2)
    scan = scan_clip(clip)
    assert 0 < len(scan.frames) < 40
    assert scan.problems[0].severity == "error"
    samples = [s for b in read_clip(clip, scan, "front", np.arange(40)) for s in b.data]
    assert numbers_in(samples, "h264") == list(range(21, 21 + len(scan.frames)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "bad.mp4: the video is missing or cannot be opened (No such file or directory)"),
        (b"", "bad.mp4: the file is empty"),
        (b"#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n", "bad.mp4: the file is not an MP4, Matroska or AVI video"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Run `git lfs pull`"),
        (b"\0\0\0\x18ftypisom" + bytes(400), "bad.mp4: the video cannot be opened"),
    ],
)
def test_what_is_no_video_says_so(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "bad.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SourceError) as caught:
        scan_clip(Clip(path, "bad.mp4", 0.0, 30.0, 10))
    assert message in str(caught.value)


def test_a_codec_that_is_not_known_says_so(videos: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "front.mp4"
    path.write_bytes(videos["h264"].read_bytes().replace(b"avc1", b"zzzz"))
    with pytest.raises(SourceError, match=r"front\.mp4: the video is in a codec that FFmpeg cannot read"):
        scan_clip(clip_of(path))


def test_samples_whose_lengths_are_wrong_are_damage(videos: dict[str, Path], tmp_path: Path) -> None:
    clip = clip_of(videos["h264"])
    scan = scan_clip(clip)
    data = bytearray(clip.path.read_bytes())
    begin = data.index(b"mdat") + 4
    data[begin : begin + 200] = b"\x7f" * 200
    path = tmp_path / "front.mp4"
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"front\.mp4: the video is damaged at frame 0"):
        list(read_clip(clip_of(path), scan, "front", np.arange(12)))
