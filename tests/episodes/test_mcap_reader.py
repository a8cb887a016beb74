"""MCAP recordings of all encodings, compressions and layouts, read as they were written."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.episode import ImageBatch, NumericBatch, numbers
from jiti.episodes.mcap_episode import McapEpisode
from jiti.episodes.mcap_reader import McapReader, mcap_episode_id
from jiti.errors import SourceError
from tests.builders import mcap_messages
from tests.builders.mcap import JOINT_NAMES, START_NS, Camera, Channel, Message, Recording, write_mcap, write_messages

LAYOUTS = [
    {"chunked": chunked, "compression": compression, "indexed": indexed, "summary": summary, "repeat": repeat}
    for chunked, compression, indexed, summary, repeat in itertools.product(
        (True, False), ("zstd", "lz4", "none"), (True, False), (True, False), (True, False)
    )
    if (chunked or compression == "none") and (summary or (indexed and repeat))
]


def opened(path: Path) -> McapEpisode:
    reader = McapReader(path)
    return reader.open(reader.episodes()[0].episode_id)


def pictures(episode: McapEpisode, stream: str) -> tuple[np.ndarray, list[bytes]]:
    batches = [b for b in episode.read([stream]) if isinstance(b, ImageBatch)]
    return np.concatenate([b.time_ns for b in batches]), [bytes(d) for b in batches for d in b.data]


def assert_same(episode: McapEpisode, written: Recording) -> None:
    """Everything that was written comes back: times to the nanosecond, bytes and numbers exactly."""
    assert {n for n, s in episode.streams.items() if s.kind != "other"} == set(written.times_ns)
    for topic, data in written.pictures.items():
        times, found = pictures(episode, topic)
        assert (times == written.times_ns[topic]).all()
        assert found == data
    for topic, values in written.numbers.items():
        times, found = numbers(episode, topic)
        assert (times == written.times_ns[topic]).all()
        assert (found == values).all()
        assert episode.streams[topic].shape == (values.shape[1],)


@pytest.mark.parametrize("encoding", ["protobuf", "ros2", "json"])
@pytest.mark.parametrize("image", ["jpeg", "png", "raw", "h264", "h265", "av1", "vp9"])
def test_every_picture_in_every_encoding(tmp_path: Path, encoding: str, image: str) -> None:
    cameras = {"/front": Camera(image), "/wrist": Camera(image, rate_hz=12.5, start_s=0.31, width=160, height=120)}
    written = write_mcap(tmp_path / "a.mcap", cameras=cameras, encoding=encoding)  # type: ignore[arg-type]
    episode = opened(written.path)
    assert_same(episode, written)
    assert (episode.clock.frame_ns == written.times_ns["/front"]).all()
    assert episode.clock.reference == "/front"
    front, wrist = episode.streams["/front"], episode.streams["/wrist"]
    assert (front.kind, front.encoding, front.shape) == ("camera", image, (240, 320, 3))
    assert (wrist.shape, wrist.count) == ((120, 160, 3), len(written.times_ns["/wrist"]))
    assert wrist.rate_hz == pytest.approx(12.5)
    names = episode.streams["/joint_states"].names
    assert names == tuple(f"{joint}.position" for joint in JOINT_NAMES)
    total = sum(len(data) for stream in written.pictures.values() for data in stream)
    share = 0.75 if encoding == "json" else 1.0
    assert total <= episode.image_bytes * share <= total + 700 * sum(map(len, written.pictures.values()))


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: "-".join(f"{k}={v}" for k, v in layout.items()))
def test_every_layout_gives_the_same(tmp_path: Path, layout: dict) -> None:
    written = write_mcap(tmp_path / "a.mcap", instruction="put it there", chunk_size=20_000, **layout)
    episode = opened(written.path)
    assert_same(episode, written)
    assert episode.task == "put it there"
    assert list(episode.problems) == []


def test_depth_is_depth_and_no_reference_when_there_is_a_camera(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", cameras={"/depth": Camera("depth"), "/front": Camera("jpeg")})
    episode = opened(written.path)
    assert episode.streams["/depth"].kind == "depth"
    assert episode.streams["/depth"].shape == (240, 320)
    assert episode.clock.reference == "/front"
    batch = next(b for b in episode.read(["/depth"]) if isinstance(b, ImageBatch))
    assert batch.raw is not None
    assert (batch.raw.pixel_format, batch.raw.row_stride) == ("16UC1", 640)
    alone = opened(write_mcap(tmp_path / "b.mcap", cameras={"/depth": Camera("depth")}).path)
    assert alone.clock.reference == "/depth"


def test_without_pictures_frames_run_at_a_fixed_rate_over_the_numbers(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", cameras={}, duration_s=3.0)
    episode = opened(written.path)
    assert episode.clock.reference is None
    assert episode.clock.rate_hz == pytest.approx(30)
    assert episode.clock.frame_count == 90
    assert episode.clock.frame_ns[0] == START_NS
    assert_same(episode, written)


def test_variable_rate_and_equal_times(tmp_path: Path) -> None:
    times_s = [0.0, 0.01, 0.01, 0.01, 0.4, 0.41, 1.9]
    written = write_mcap(tmp_path / "a.mcap", cameras={"/front": Camera("h264", times_s=times_s)})
    episode = opened(written.path)
    assert_same(episode, written)
    assert episode.clock.frame_count == 7
    assert len(set(episode.clock.display_ns.tolist())) == 7


def test_a_camera_that_starts_late_is_reported_with_its_frames(tmp_path: Path) -> None:
    written = write_mcap(
        tmp_path / "a.mcap", cameras={"/front": Camera(), "/late": Camera(start_s=1.0)}, duration_s=2.0
    )
    episode = opened(written.path)
    assert_same(episode, written)
    problem = next(p for p in episode.problems if "/late" in p.where)
    assert "at 30 of 60 frames (first 0, last 29) there is no message yet" in problem.what


def test_a_stream_that_starts_a_moment_after_the_camera_is_not_late(tmp_path: Path) -> None:
    cameras = {"/front": Camera(), "/late": Camera(start_s=0.4)}
    assert list(opened(write_mcap(tmp_path / "a.mcap", cameras=cameras).path).problems) == []


def test_a_stream_with_a_gap_is_reported_and_a_latched_one_is_not(tmp_path: Path) -> None:
    schema, data = mcap_messages.vector("json", [1.0, 2.0], 0)
    written = write_mcap(tmp_path / "pick.mcap", joint_topic=None, action_topic=None)
    front = [
        Message("/front", t, mcap_messages.picture("json", "jpeg", 320, 240, t, picture)[1])
        for t, picture in zip(
            written.times_ns["/camera/front"].tolist(), written.pictures["/camera/front"], strict=True
        )
    ]
    gap = [Message("/gap", START_NS + k * 10**7, data) for k in range(200) if not 50 <= k < 150]
    channels = {
        "/front": Channel(mcap_messages.json_schema("foxglove.CompressedImage"), "json"),
        "/gap": Channel(schema, "json"),
        "/once": Channel(schema, "json"),
    }
    write_messages(tmp_path / "a.mcap", channels, [Message("/once", START_NS, data), *front, *gap])
    problems = [str(p) for p in opened(tmp_path / "a.mcap").problems]
    assert len(problems) == 1
    assert problems[0].startswith("a.mcap, /gap: at 15 of 60 frames (first 30, last 44)")


def test_reading_some_streams_and_asking_for_one_that_is_not_there(tmp_path: Path) -> None:
    episode = opened(write_mcap(tmp_path / "a.mcap").path)
    assert {b.stream for b in episode.read(["/action", "/camera/front"])} == {"/action", "/camera/front"}
    with pytest.raises(SourceError, match=r"a\.mcap has no stream '/wrist'; it has: /camera/front, /joint_states, /a"):
        episode.read(["/wrist"])


def test_batches_interleave_by_time_and_never_go_back(tmp_path: Path) -> None:
    written = write_mcap(tmp_path / "a.mcap", duration_s=4.0, chunk_size=20_000)
    last: dict[str, int] = {}
    newest = 0
    for batch in opened(written.path).read():
        assert (np.diff(batch.time_ns) >= 0).all()
        assert batch.time_ns[0] >= last.get(batch.stream, 0)
        last[batch.stream] = int(batch.time_ns[-1])
        # Streams are not more than two chunks apart.
        assert batch.time_ns[-1] > newest - 1_500_000_000
        newest = max(newest, int(batch.time_ns[-1]))


def test_a_recording_that_changed_after_opening_is_refused(tmp_path: Path) -> None:
    episode = opened(write_mcap(tmp_path / "a.mcap").path)
    write_mcap(tmp_path / "a.mcap", duration_s=1.0)
    with pytest.raises(SourceError, match="changed since it was opened"):
        list(episode.read())


def test_the_fingerprint_changes_with_the_bytes(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap").path
    first = opened(path).fingerprint
    assert opened(path).fingerprint == first
    write_mcap(path, duration_s=1.9)
    assert opened(path).fingerprint != first


def test_several_hundred_channels(tmp_path: Path) -> None:
    schema, _ = mcap_messages.vector("ros2", [0.0] * 7, 0)
    payloads = [mcap_messages.vector("ros2", [float(k)] * 7, 0)[1] for k in range(40)]
    channels = {f"/v{c:03}": Channel(schema, "cdr") for c in range(400)}
    messages = [Message(topic, START_NS + k * 10**8, payloads[k]) for k in range(40) for topic in channels]
    write_messages(tmp_path / "a.mcap", channels, messages)
    episode = opened(tmp_path / "a.mcap")
    assert len(episode.streams) == 400
    seen = dict.fromkeys(channels, 0)
    for batch in episode.read():
        assert isinstance(batch, NumericBatch)
        assert (batch.values[:, 3] == np.arange(seen[batch.stream], seen[batch.stream] + len(batch.values))).all()
        seen[batch.stream] += len(batch.values)
    assert set(seen.values()) == {40}


def test_channels_of_one_topic_are_one_stream_unless_their_schemas_differ(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schemas = [writer.register_schema(name, "jsonschema", b"{}") for name in ("one", "two")]
        ids = [writer.register_channel("/x", "json", schema) for schema in (schemas[0], schemas[0], schemas[1])]
        for k in range(30):
            writer.add_message(ids[k % 3], 1000 + k, b'{"v": %d}' % k, 1000 + k)
        writer.finish()
    episode = opened(tmp_path / "a.mcap")
    assert list(episode.streams) == ["/x", "/x (channel 3)"]
    times, values = numbers(episode, "/x")
    assert times.tolist() == [1000 + k for k in range(30) if k % 3 != 2]
    assert values[:, 0].tolist() == [k for k in range(30) if k % 3 != 2]
    assert episode.streams["/x (channel 3)"].count == 10


@pytest.mark.parametrize(
    ("topic", "made"),
    [
        ("/task", mcap_messages.json_schema("std_msgs/msg/String")),
        ("/robot/language_instruction", mcap_messages.ros_schema("std_msgs/msg/String")),
        ("/episode", mcap_messages.json_schema("Episode")),
    ],
)
def test_the_instruction_from_a_topic(tmp_path: Path, topic: str, made: mcap_messages.Schema) -> None:
    from types import SimpleNamespace

    if made.message_encoding == "cdr":
        data = mcap_messages.ros_payload(made.name, SimpleNamespace(data="pick it up"))
    else:
        data = b'{"data": "pick it up"}' if topic == "/task" else b'{"instruction": "pick it up", "n": 1}'
    vector, payload = mcap_messages.vector("json", [1.0], 0)
    channels = {topic: Channel(made, made.message_encoding), "/v": Channel(vector, "json")}
    messages = [Message(topic, 5, data), *(Message("/v", k, payload) for k in range(10))]
    write_messages(tmp_path / "a.mcap", channels, messages)
    assert opened(tmp_path / "a.mcap").task == "pick it up"


def test_the_instruction_from_metadata_comes_first(tmp_path: Path) -> None:
    metadata = {"other": {"a": "b"}, "x": {"Task": " stack "}}
    assert opened(write_mcap(tmp_path / "a.mcap", metadata=metadata).path).task == "stack"


def test_listing_reads_no_more_than_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mcap(tmp_path / "sub" / "a.mcap").path
    good = path.read_bytes()
    path.write_bytes(good[:8] + b"\xff" * 100)  # nothing after the magic is looked at
    reader = McapReader(path, root=tmp_path)
    (ref,) = reader.episodes()
    assert (ref.episode_id, ref.title, ref.size_bytes, ref.problem) == ("sub%2Fa", "sub/a.mcap", 108, None)
    assert (reader.title, reader.labels_dir) == ("a.mcap", str(tmp_path / "labels"))
    assert McapReader(path).labels_dir == str(tmp_path / "sub" / "labels")
    with pytest.raises(SourceError, match=r"has no episode 'b'; it has: sub%2Fa"):
        reader.open("b")


@pytest.mark.parametrize(("content", "what"), [(b"", "it is empty (0 bytes)"), (b"PK\x03\x04", "does not start like")])
def test_listing_names_what_is_no_recording(tmp_path: Path, content: bytes, what: str) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    (ref,) = McapReader(tmp_path / "a.mcap").episodes()
    assert ref.problem is not None
    assert what in ref.problem.what
    (ref,) = McapReader(tmp_path / "missing.mcap").episodes()
    assert ref.problem is not None
    assert "no such file" in ref.problem.what


def test_ids_are_safe_file_names_and_never_the_same() -> None:
    root = Path("/data")
    names = ["a.mcap", "b/a.mcap", "b%2Fa.mcap", ".a.mcap", "%2Ea.mcap", "ä b.mcap", "a.MCAP", "a", "x" * 250 + ".mcap"]
    names += ["y/" * 100 + "a.mcap", "y/" * 100 + "b.mcap", "..mcap", "a.mcap.mcap"]
    ids = [mcap_episode_id(root / name, root) for name in names]
    assert ids[:4] == ["a", "b%2Fa", "b%252Fa", "%2Ea"]
    assert len(set(ids)) == len(ids)
    for made in ids:
        assert len(made) <= 180
        assert "/" not in made
        assert not made.startswith(".")
    assert mcap_episode_id(Path("/data/sub/a.mcap"), Path("/data/sub")) == "a"
