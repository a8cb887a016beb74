"""Pictures of MCAP messages: what they really are, and those that cannot be used."""

import base64
import json
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import foxglove.messages as fox
import numpy as np
import pytest

from jiti.episodes.episode import ImageBatch
from jiti.episodes.mcap_episode import McapEpisode
from tests.builders.encode import encode_numbered
from tests.builders.mcap import START_NS, Channel, Message, write_messages
from tests.builders.mcap_messages import fox_schema, json_schema, ros_header, ros_payload, ros_schema

JPEG, PNG = (encode_numbered([7], image, 64, 48)[0] for image in ("jpeg", "png"))
H264 = encode_numbered(range(3), "h264", 64, 48)
STEP = 33_333_333


def compressed(path: Path, pictures: list[tuple[bytes, str]], name: str = "foxglove.CompressedImage") -> McapEpisode:
    bodies = [json.dumps({"data": base64.b64encode(data).decode(), "format": kind}) for data, kind in pictures]
    return written(path, json_schema(name), [body.encode() for body in bodies])


def written(path: Path, schema: Any, payloads: list[bytes]) -> McapEpisode:
    messages = [Message("/cam", START_NS + k * STEP, payload) for k, payload in enumerate(payloads)]
    write_messages(path / "a.mcap", {"/cam": Channel(schema, schema.message_encoding)}, messages)
    return McapEpisode(path / "a.mcap", "a")


def raw_image(**changes: Any) -> bytes:
    fields = {
        "width": 4,
        "height": 3,
        "encoding": "rgb8",
        "step": 12,
        "data": bytes(range(36)),
        "is_bigendian": 0,
    } | changes
    return ros_payload("sensor_msgs/msg/Image", SimpleNamespace(header=ros_header(0), **fields))


def batches(episode: McapEpisode) -> list[ImageBatch]:
    return [b for b in episode.read() if isinstance(b, ImageBatch)]


def png_of(width: int, height: int, depth: int = 8, colour: int = 2) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + head + bytes(4)


def jpeg_of(width: int, height: int) -> bytes:
    return b"\xff\xd8\xff\xe0\x00\x04JF\xff\xc0\x00\x11\x08" + struct.pack(">HHB", height, width, 3) + bytes(40)


@pytest.mark.parametrize(
    ("data", "declared", "encoding", "kind", "said"),
    [
        (JPEG, "jpeg", "jpeg", "camera", None),
        (JPEG, "jpg", "jpeg", "camera", None),
        (JPEG, "", "jpeg", "camera", None),
        (JPEG, "rgb8; jpeg compressed bgr8", "jpeg", "camera", None),
        (JPEG, "png", "jpeg", "camera", "are JPEG and declared as 'png'"),
        (PNG, "png", "png", "camera", None),
        (PNG, "bgr8; png compressed bgr8", "png", "camera", None),
        (PNG, "jpeg", "png", "camera", "are PNG and declared as 'jpeg'"),
        (png_of(64, 48, 16, 0), "png", "png", "depth", None),
        (bytes(12) + png_of(64, 48, 16, 0), "16UC1; compressedDepth", "png", "depth", None),
        (bytes(12) + png_of(64, 48, 8, 6), "32FC1; compressedDepth png", "png", "depth", None),
        (H264[0], "h264", "h264", "camera", None),
    ],
)
def test_pictures_are_what_their_bytes_are(
    tmp_path: Path, data: bytes, declared: str, encoding: str, kind: str, said: str | None
) -> None:
    episode = compressed(tmp_path, [(data, declared)] * 3)
    stream = episode.streams["/cam"]
    assert (stream.encoding, stream.kind, stream.shape[:2]) == (encoding, kind, (48, 64))
    (batch,) = batches(episode)
    assert (batch.encoding, set(batch.data)) == (encoding, {data[12:] if data[:12] == bytes(12) else data})
    assert [problem.what.split(";")[0] for problem in episode.problems] == ([f"3 of 3 pictures {said}"] if said else [])


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"", "its picture is empty"),
        (b"\0" * 50, "it declares 'jpeg' and starts with 00 00 00 00, which is not a JPEG or PNG picture"),
        (b"RIFF1234WEBPVP8 ", "starts with 52 49 46 46, which is not a JPEG or PNG picture"),
        (jpeg_of(60_000, 15_000), "it declares 60000x15000 pixels; the limit is 100 megapixels"),
        (png_of(30_000, 30_000), "it declares 30000x30000 pixels; the limit is 100 megapixels"),
        (jpeg_of(0, 0), "it declares 0x0 pixels"),
        (b"\xff\xd8\xff\xe0\x00\x04JF", "its JPEG header has no size"),
        (b"\x89PNG\r\n\x1a\n1234", "its PNG header is incomplete"),
    ],
)
def test_pictures_that_cannot_be_used_are_left_out(tmp_path: Path, bad: bytes, reason: str) -> None:
    episode = compressed(tmp_path, [(JPEG, "jpeg"), (bad, "jpeg"), (JPEG, "jpeg"), (bad, "jpeg")])
    assert [len(batch.data) for batch in batches(episode)] == [2]
    assert episode.clock.frame_count == 4  # frames keep their numbers
    (problem,) = episode.problems
    assert problem.where == "a.mcap, /cam, message 1 at 0.033 s"
    assert problem.what.startswith("2 of 4 pictures cannot be used and are left out; of the first, ")
    assert reason in problem.what


def test_a_camera_none_of_whose_pictures_can_be_used(tmp_path: Path) -> None:
    episode = compressed(tmp_path, [(b"nonsense", "jpeg")] * 5)
    assert episode.streams["/cam"].kind == "other"
    first, second = (problem.what for problem in episode.problems)
    assert first.startswith("none of the pictures that were looked at can be used: it declares 'jpeg' and starts with")
    assert second.startswith("it has neither pictures nor numbers")


def test_a_first_picture_that_cannot_be_used_does_not_cost_the_camera(tmp_path: Path) -> None:
    episode = compressed(tmp_path, [(b"nonsense", "jpeg")] * 3 + [(JPEG, "jpeg")])
    assert (episode.streams["/cam"].kind, episode.streams["/cam"].shape) == ("camera", (48, 64, 3))


def test_a_camera_that_changes_its_format_gives_batches_of_one_format(tmp_path: Path) -> None:
    episode = compressed(tmp_path, [(JPEG, "jpeg"), (JPEG, "jpeg"), (PNG, "png"), (JPEG, "jpeg")])
    assert [(b.encoding, len(b.data)) for b in batches(episode)] == [("jpeg", 2), ("png", 1), ("jpeg", 1)]


@pytest.mark.parametrize(
    ("data", "declared", "reason"),
    [
        (b"\0\0\0\x05\x65abcd", "h264", "it declares h264 and starts with 00 00 00 05, not with an Annex B start code"),
        (H264[0], "mpeg2", "its video format 'mpeg2' is not one of av1, h264, h265, vp9"),
    ],
)
def test_video_that_cannot_be_used(tmp_path: Path, data: bytes, declared: str, reason: str) -> None:
    episode = compressed(tmp_path, [(data, declared)] * 3, "foxglove.CompressedVideo")
    assert reason in episode.problems[0].what


@pytest.mark.parametrize(("first", "shape"), [([], ()), (H264, (48, 64, 3))])
def test_video_that_does_not_start_with_a_key_frame(tmp_path: Path, first: list[bytes], shape: tuple) -> None:
    pictures = [*H264[1:], *first]
    episode = compressed(tmp_path, [(data, "h264") for data in pictures], "foxglove.CompressedVideo")
    assert (episode.streams["/cam"].shape, episode.streams["/cam"].kind) == (shape, "camera")
    assert [list(b.data) for b in batches(episode)] == [pictures]
    assert [p.what.split(";")[0] for p in episode.problems] == ["it does not start with a key frame"]


@pytest.mark.parametrize(
    ("changes", "shape"),
    [
        ({}, (3, 4, 3)),
        ({"encoding": "mono8", "step": 4, "data": bytes(12)}, (3, 4)),
        ({"encoding": "bgra8", "step": 16, "data": bytes(48)}, (3, 4, 4)),
        ({"encoding": "bayer_rggb8", "step": 4, "data": bytes(12)}, (3, 4)),
        ({"step": 20, "data": bytes(60)}, (3, 4, 3)),
        ({"step": 20, "data": bytes(52)}, (3, 4, 3)),  # the last row without its padding
        ({"step": 0}, (3, 4, 3)),
    ],
)
def test_raw_pictures(tmp_path: Path, changes: dict, shape: tuple[int, ...]) -> None:
    episode = written(tmp_path, ros_schema("sensor_msgs/msg/Image"), [raw_image(**changes)] * 2)
    assert (episode.streams["/cam"].shape, episode.streams["/cam"].kind) == (shape, "camera")
    (batch,) = batches(episode)
    assert batch.raw is not None
    assert (batch.raw.height, batch.raw.width, batch.raw.row_stride) == (3, 4, changes.get("step") or 12)
    assert batch.data[0] == changes.get("data", bytes(range(36)))
    assert list(episode.problems) == []


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"data": bytes(35)}, "it has 35 bytes; 3 rows of 12 bytes are declared"),
        ({"step": 11}, "its rows have 11 bytes; 4 pixels of rgb8 need 12"),
        ({"width": 30_000, "height": 30_000}, "it declares 30000x30000 pixels; the limit is 100 megapixels"),
        ({"width": 2**32 - 1, "height": 2**32 - 1}, "it declares 4294967295x4294967295 pixels"),
        ({"height": 0}, "it declares 4x0 pixels"),
        ({"encoding": "nv12"}, "its pixel format 'nv12' is not one of rgb8, bgr8"),
        ({"data": b""}, "its picture is empty"),
    ],
)
def test_raw_pictures_that_cannot_be_used(tmp_path: Path, changes: dict, reason: str) -> None:
    episode = written(tmp_path, ros_schema("sensor_msgs/msg/Image"), [raw_image(), raw_image(**changes)])
    assert sum(len(batch.data) for batch in batches(episode)) == 1
    assert reason in episode.problems[0].what


@pytest.mark.parametrize(("pixel", "dtype"), [("16UC1", "u2"), ("mono16", "u2"), ("32FC1", "f4")])
def test_big_endian_depth_becomes_little_endian(tmp_path: Path, pixel: str, dtype: str) -> None:
    values = np.arange(12).reshape(3, 4) * 100
    data = values.astype(f">{dtype}").tobytes()
    message = raw_image(encoding=pixel, step=len(data) // 3, data=data, is_bigendian=1)
    episode = written(tmp_path, ros_schema("sensor_msgs/msg/Image"), [message] * 3)
    assert episode.streams["/cam"].kind == "depth"
    (batch,) = batches(episode)
    assert (np.frombuffer(batch.data[0], f"<{dtype}").reshape(3, 4) == values).all()


def test_foxglove_raw_image_with_a_width_of_zero_on_the_wire(tmp_path: Path) -> None:
    payload = fox.RawImage(height=3, encoding="mono8", step=4, data=bytes(12)).encode()
    episode = written(tmp_path, fox_schema(fox.RawImage), [payload] * 2)
    assert "it declares 0x3 pixels" in episode.problems[0].what


def test_a_picture_that_is_not_base64(tmp_path: Path) -> None:
    good = json.dumps({"data": base64.b64encode(JPEG).decode(), "format": "jpeg"}).encode()
    payloads = [good, b'{"data": "?!", "format": "jpeg"}', b'{"format": "jpeg"}', b'{"data": 5}']
    episode = written(tmp_path, json_schema("foxglove.CompressedImage"), payloads)
    assert sum(len(batch.data) for batch in batches(episode)) == 1
    assert "3 of 4 pictures cannot be used and are left out; of the first, its picture is not base64" in (
        episode.problems[0].what
    )


def test_a_camera_without_messages_is_named(tmp_path: Path) -> None:
    schema = json_schema("foxglove.CompressedImage")
    channels = {"/cam": Channel(schema, "json"), "/v": Channel(json_schema("X"), "json")}
    write_messages(tmp_path / "a.mcap", channels, [Message("/v", k, b'{"v": 1}') for k in range(5)])
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    assert [str(p) for p in episode.problems] == [
        "a.mcap, /cam: the camera has no pictures. Check what records this stream"
    ]
    assert episode.clock.reference is None
