"""Recordings written here: read back exactly, understood by others, whole or not there at all."""

import math
from pathlib import Path
from typing import Any

import foxglove.messages as fox
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from jiti.episodes.episode import ImageBatch, numbers
from jiti.episodes.mcap_episode import McapEpisode
from jiti.episodes.mcap_schemas import DEFINITIONS, message_class
from jiti.episodes.mcap_writer import McapWriter
from jiti.errors import SaveFailed, UsageError
from tests.builders.encode import encode_numbered

JPEG, PNG = (encode_numbered(range(5), image, 64, 48) for image in ("jpeg", "png"))
H264 = encode_numbered(range(5), "h264", 64, 48)
NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=5)
TIMES = [10**18 + k * 33_333_333 for k in range(5)]


def record(path: Path, **options: Any) -> Path:
    with McapWriter(path, **options) as writer:
        for k, time_ns in enumerate(TIMES):
            writer.write_picture("/front", time_ns, JPEG[k], frame_id="camera")
            writer.write_picture("/wrist", time_ns, PNG[k])
            writer.write_video("/top", time_ns, H264[k], "h264")
            writer.write_joints("/joints", time_ns, ["a", "grip"], [k, 0.0], velocity=np.array([0.5, k]))
            writer.write_pose("/ee", time_ns, (0, k, 0.25), (0, 0, 0, 1), frame_id="base")
            writer.write_vector("/action", time_ns, ["x", "grip"], [0.0, k])
        writer.write_metadata("outcome", {"success": "true"})
    return path


def test_what_was_written_is_read_back(tmp_path: Path) -> None:
    episode = McapEpisode(record(tmp_path / "new" / "a.mcap", instruction="pick", metadata={"seed": "3"}), "a")
    assert list(episode.problems) == []
    assert episode.task == "pick"
    assert episode.clock.reference == "/front"
    for topic, kind, data in (("/front", "jpeg", JPEG), ("/wrist", "png", PNG), ("/top", "h264", H264)):
        (batch,) = episode.read([topic])
        assert isinstance(batch, ImageBatch)
        assert (batch.time_ns.tolist(), batch.encoding, list(batch.data)) == (TIMES, kind, data)
    expected = {
        "/joints": ("a.position", "a.velocity", "grip.position", "grip.velocity"),
        "/ee": tuple(f"pose.position.{a}" for a in "xyz") + tuple(f"pose.orientation.{a}" for a in "xyzw"),
        "/action": ("x", "grip"),
    }
    assert {topic: episode.streams[topic].names for topic in expected} == expected
    times, joints = numbers(episode, "/joints")
    assert times.tolist() == TIMES
    assert joints.tolist() == [[k, 0.5, 0.0, k] for k in range(5)]
    assert numbers(episode, "/ee")[1].tolist() == [[0, k, 0.25, 0, 0, 0, 1] for k in range(5)]
    assert numbers(episode, "/action")[1].tolist() == [[0.0, k] for k in range(5)]


def test_the_mcap_library_reads_the_same(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", instruction="pick", metadata={"seed": "3"})
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages())
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        summary = reader.get_summary()
    assert metadata == {"jiti": {"instruction": "pick", "seed": "3"}, "outcome": {"success": "true"}}
    assert len(decoded) == 30
    for schema, channel, message, content in decoded:
        assert schema is not None
        assert content.timestamp.ToNanoseconds() == message.log_time == message.publish_time
        assert message.sequence == TIMES.index(message.log_time)
        assert channel.message_encoding == "protobuf"
    joints = next(m.decoded_message for m in decoded if m.channel.topic == "/joints")
    assert [(j.name, j.HasField("velocity"), j.HasField("effort")) for j in joints.joints] == [
        ("a", True, False),
        ("grip", True, False),
    ]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 30
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}


def test_the_same_calls_give_the_same_file(tmp_path: Path) -> None:
    assert record(tmp_path / "a.mcap").read_bytes() == record(tmp_path / "b.mcap").read_bytes()


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(st.integers(0, 2**62), st.lists(st.floats(), min_size=3, max_size=3)), min_size=1),
    names=st.lists(NAMES, min_size=3, max_size=3, unique=True),
)
def test_any_numbers_and_times_survive(tmp_path: Path, rows: list, names: list[str]) -> None:
    rows.sort(key=lambda row: row[0])
    with McapWriter(tmp_path / "a.mcap", overwrite=True) as writer:
        for time_ns, values in rows:
            writer.write_vector("/x", time_ns, names, values)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    times, values = numbers(episode, "/x")
    assert times.tolist() == [time_ns for time_ns, _ in rows]
    assert episode.streams["/x"].names == tuple(names)
    np.testing.assert_array_equal(values, [row for _, row in rows])
    signs = [[math.copysign(1, v) for v in row] for _, row in rows]
    assert [[math.copysign(1, v) for v in row] for row in values.tolist()] == signs


def foxglove_class(name: str) -> type[Any]:
    schema = getattr(fox, name).get_schema()
    pool = DescriptorPool()
    waiting = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}

    def add(file: FileDescriptorProto) -> None:
        for needed in file.dependency:
            if needed in waiting:
                add(waiting.pop(needed))
        pool.Add(file)

    while waiting:
        add(waiting.popitem()[1])
    return GetMessageClass(pool.FindMessageTypeByName(schema.name))


@pytest.mark.parametrize("name", [name for name in DEFINITIONS if name.startswith("foxglove.")])
def test_schemas_are_those_of_foxglove(name: str) -> None:
    ours = message_class(name).DESCRIPTOR
    theirs = foxglove_class(name.split(".")[1]).DESCRIPTOR
    assert ours.full_name == theirs.full_name

    def described(descriptor: Any) -> list[tuple]:
        return [
            (f.name, f.number, f.type, f.is_repeated, f.has_presence, f.message_type and f.message_type.full_name)
            for f in sorted(descriptor.fields, key=lambda f: f.number)
        ]

    assert described(ours) == described(theirs)
    assert ours.file.name == theirs.file.name


def test_a_recording_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fall_over() -> None:
        with McapWriter(tmp_path / "a.mcap") as writer:
            writer.write_picture("/front", 0, JPEG[0])
            raise RuntimeError("robot fell over")

    with pytest.raises(RuntimeError, match="robot fell over"):
        fall_over()
    assert list(tmp_path.iterdir()) == []
    writer = McapWriter(tmp_path / "a.mcap")
    writer.discard()
    writer.discard()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match=r"a\.mcap is closed"):
        writer.write_picture("/front", 0, JPEG[0])


def test_a_recording_has_its_name_only_once_it_is_whole(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "a.mcap")
    writer.write_vector("/x", 0, ["a"], [1])
    (temporary,) = tmp_path.iterdir()
    assert temporary.name.startswith(".")
    writer.close()
    writer.close()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_an_existing_recording_is_not_replaced_unasked(tmp_path: Path) -> None:
    first = record(tmp_path / "a.mcap").read_bytes()
    with pytest.raises(UsageError, match=r"a\.mcap exists already\. Choose another name"):
        McapWriter(tmp_path / "a.mcap")
    with pytest.raises(RuntimeError), McapWriter(tmp_path / "a.mcap", overwrite=True):
        raise RuntimeError
    assert (tmp_path / "a.mcap").read_bytes() == first


def test_a_disk_that_refuses(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SaveFailed, match="file could not be saved"):
        McapWriter(tmp_path / "file" / "a.mcap")


def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill() -> None:
        with Path("/dev/full").open("wb", buffering=0) as full, McapWriter(tmp_path / "a.mcap") as writer:
            # The device that is always full stands in for a full disk.
            monkeypatch.setattr(writer._writer, "_Writer__stream", full)
            for time_ns in TIMES:
                writer.write_video("/top", time_ns, bytes(400_000), "h264")

    with pytest.raises(SaveFailed, match=r"a\.mcap could not be saved: no space left on device"):
        fill()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda w: w.write_picture("/p", 0, b"GIF89a"),
            r"/p: a picture starts with 47 49 46 38; give whole JPEG or PNG",
        ),
        (
            lambda w: w.write_video("/p", 0, b"x", "mpeg4"),
            r"/p: video cannot be 'mpeg4'; it can be: av1, h264, h265, v",
        ),
        (lambda w: w.write_vector("/v", 0, ["a"], [1, 2]), r"/v: values has 2 numbers for 1 names: a\."),
        (lambda w: w.write_joints("/j", 0, ["a", "b"], [1, 2], effort=[1]), r"/j: effort has 1 numbers for 2 names"),
        (lambda w: w.write_pose("/e", 0, [0, 0], [0] * 4, frame_id=""), r"/e: position_m has 2 numbers for 3 names"),
        (lambda w: w.write_vector("/v", -1, ["a"], [1]), r"/v: the time -1 ns is not in 0 to 2\^63"),
        (
            lambda w: w.write_vector("/front", 0, ["a"], [1]),
            r"/front holds foxglove\.CompressedImage; a jiti\.NamedVec",
        ),
    ],
)
def test_wrong_calls_are_refused_and_cost_nothing(tmp_path: Path, call: Any, message: str) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer:
        writer.write_picture("/front", 0, JPEG[0])
        with pytest.raises(UsageError, match=message):
            call(writer)
        writer.write_picture("/front", 1, JPEG[1])
    assert McapEpisode(tmp_path / "a.mcap", "a").clock.frame_count == 2
