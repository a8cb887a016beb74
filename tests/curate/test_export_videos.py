"""Videos of curated datasets: every picture carries its own frame number, so that a test can tell which is shown."""

import json
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest

from jiti.curate.export import build as build_module
from jiti.curate.export.codec import WORST
from jiti.curate.export.remux import join_videos, kind_of
from jiti.episodes.reader import open_reader
from jiti.episodes.video import decode_frames
from tests.builders.curate import curated, mark, write_picks
from tests.builders.lerobot import ENCODERS, FRONT, H264_LONG_GOP, WRIST, episode_pictures, write_v3, write_video
from tests.builders.mcap import Camera
from tests.builders.pictures import read_number

GOOD = [(2, 6, 1)]


def shown(dataset: Path, episode_id: str, camera: str = FRONT) -> list[int]:
    """The number in the picture of each frame."""
    episode = open_reader(dataset).open(episode_id)
    frames = range(episode.clock.frame_count)
    return [read_number(picture) for _, picture in decode_frames(episode, camera, frames)]


def packets(path: Path) -> list[bytes]:
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


@pytest.fixture(scope="module")
def demos(tmp_path_factory) -> Path:
    cameras = {
        "/camera/front": Camera(),
        "/camera/wrist/image_raw": Camera(image="h264", rate_hz=15, first_number=100, gop=8),
    }
    return write_picks(tmp_path_factory.mktemp("videos") / "demos", [GOOD, GOOD, GOOD], cameras=cameras)


def test_every_frame_shows_its_own_picture(demos, tmp_path):
    curated(demos, out=tmp_path / "d")
    for number, count in enumerate((30, 36, 42)):
        episode_id = f"episode_{number:06d}"
        assert shown(tmp_path / "d", episode_id) == list(range(count))
        assert shown(tmp_path / "d", episode_id, WRIST) == [100 + k // 2 for k in range(count)]
    files = sorted(path.relative_to(tmp_path / "d").as_posix() for path in (tmp_path / "d").rglob("*.mp4"))
    assert files == [f"videos/{camera}/chunk-000/file-000.mp4" for camera in (FRONT, WRIST)]
    assert not list(tmp_path.rglob("*.png"))
    entry = pq.read_table(tmp_path / "d" / "meta" / "episodes").to_pylist()[1]
    assert (entry[f"videos/{FRONT}/from_timestamp"], entry[f"videos/{FRONT}/to_timestamp"]) == (1.0, 2.2)
    info = json.loads((tmp_path / "d" / "meta" / "info.json").read_text())["features"][FRONT]
    assert info["shape"] == [240, 320, 3]
    assert info["info"]["video.codec"] == "h264"


def test_resampled_frames_show_the_picture_of_their_time(demos, tmp_path):
    curated(demos, out=tmp_path / "d", fps=10)
    assert shown(tmp_path / "d", "episode_000001") == list(range(0, 36, 3))
    assert shown(tmp_path / "d", "episode_000001", WRIST) == [100 + k // 2 for k in range(0, 36, 3)]
    curated(demos, out=tmp_path / "e", fps=60, condition="episode == 'pick_0'")
    assert shown(tmp_path / "e", "episode_000000") == [k // 2 for k in range(59)]


@pytest.mark.parametrize("codec", ["h264", "hevc", "av1"])
def test_the_encoders_take_the_largest_crf(tmp_path, codec):
    one = write_picks(tmp_path / "demos", [GOOD], cameras={"/camera/front": Camera(width=64, height=64)})
    assert curated(one, out=tmp_path / "d", codec=codec, crf=WORST[codec]).frames == 30


@pytest.mark.parametrize("codec", ["hevc", "av1"])
def test_other_codecs(demos, tmp_path, codec):
    curated(demos, out=tmp_path / "d", codec=codec, crf=20, condition="episode == 'pick_0'")
    with av.open(str(tmp_path / "d" / "videos" / FRONT / "chunk-000" / "file-000.mp4")) as container:
        assert container.streams.video[0].codec_context.codec.canonical_name == codec
        assert sum(1 for _ in container.decode(video=0)) == 30


def test_colours_stay(demos, tmp_path):
    curated(demos, out=tmp_path / "d", condition="episode == 'pick_0'")
    before, after = (open_reader(p).open(n) for p, n in ((demos, "pick_0"), (tmp_path / "d", "episode_000000")))
    for (_, one), (_, other) in zip(
        decode_frames(before, "/camera/front", [0, 9]), decode_frames(after, FRONT, [0, 9]), strict=True
    ):
        assert np.abs(one.astype(int) - other).mean() < 2


def test_files_are_begun_anew_when_they_are_full(demos, tmp_path, monkeypatch):
    monkeypatch.setattr(build_module, "VIDEO_FILE_BYTES", 1)
    monkeypatch.setattr(build_module, "DATA_FILE_BYTES", 1)
    curated(demos, out=tmp_path / "d")
    assert len(list((tmp_path / "d").rglob("*.mp4"))) == 6
    assert len(list((tmp_path / "d" / "data").rglob("*.parquet"))) == 3
    assert shown(tmp_path / "d", "episode_000002") == list(range(42))


@pytest.fixture(scope="module", params=["h264", "h264_b_frames", "av1"])
def lerobot_source(request, tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("source") / "source"
    write_v3(root, (12, 9, 15), encoder=ENCODERS[request.param], cameras=(FRONT, WRIST), number_step=20)
    for number in range(3):
        mark(root, f"episode_{number:06d}", GOOD)
    return root


def test_videos_of_lerobot_datasets_are_copied(lerobot_source, tmp_path):
    """Episode 1 is left out, so that the rest moves."""
    done = curated(lerobot_source, out=tmp_path / "d", condition="episode != 'episode_000001'")
    assert shown(tmp_path / "d", "episode_000000") == list(range(12))
    assert shown(tmp_path / "d", "episode_000001", WRIST) == [40 + k for k in range(15)]
    copied = set(packets(tmp_path / "d" / "videos" / FRONT / "chunk-000" / "file-000.mp4"))
    original = packets(lerobot_source / "videos" / FRONT / "chunk-000" / "file-000.mp4")
    if not done.notes:
        assert copied <= set(original)
    for note in done.notes:
        assert "encoded anew, because" in note


def test_h264_and_av1_are_copied_without_a_word(tmp_path):
    for encoder in ("h264", "av1"):
        root = write_v3(tmp_path / encoder, (12, 9), encoder=ENCODERS[encoder])
        mark(root, "episode_000001", GOOD)
        assert curated(root, out=tmp_path / f"{encoder}-out").notes == ()


def test_an_episode_that_begins_between_key_frames_is_encoded_anew(tmp_path):
    root = write_v3(tmp_path / "source", (12, 9), number_step=20)
    pictures = [picture for e, n in ((0, 12), (1, 9)) for picture in episode_pictures(e, n, FRONT, (160, 120), 20)]
    write_video(root / "videos" / FRONT / "chunk-000" / "file-000.mp4", [pictures], H264_LONG_GOP, 30)
    for number in range(2):
        mark(root, f"episode_{number:06d}", GOOD)
    done = curated(root, out=tmp_path / "d")
    assert len(done.notes) == 1
    assert "source, episode 1, observation.images.front: encoded anew, because it does not begin" in done.notes[0]
    assert shown(tmp_path / "d", "episode_000000") == list(range(12))
    assert shown(tmp_path / "d", "episode_000001") == [20 + k for k in range(9)]
    assert len(list((tmp_path / "d").rglob("*.mp4"))) == 2  # two encoders' settings are never in one file


def test_a_wanted_codec_is_encoded(tmp_path):
    root = write_v3(tmp_path / "source", (12,), encoder=ENCODERS["av1"])
    mark(root, "episode_000000", GOOD)
    curated(root, out=tmp_path / "d", codec="h264")
    assert kind_of(next((tmp_path / "d").rglob("*.mp4"))).startswith("h264")


def test_joined_videos_begin_where_those_before_end(demos, tmp_path):
    curated(demos, out=tmp_path / "d", condition="episode == 'pick_0'")
    piece = tmp_path / "d" / "videos" / FRONT / "chunk-000" / "file-000.mp4"
    join_videos([piece, piece], tmp_path / "two.mp4", 30)
    with av.open(str(tmp_path / "two.mp4")) as container:
        times = [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]
    np.testing.assert_allclose(times, np.arange(60) / 30, atol=1e-9)
