"""Messages that cannot be read, and streams that change."""

from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.episode import NumericBatch
from jiti.errors import SourceError
from tests.builders.mcap import Channel, Message, write_messages
from tests.builders.mcap_messages import Schema, json_schema, vector
from tests.builders.mcap_seen import counts, opened, whats


def test_encodings_that_are_not_supported(tmp_path: Path) -> None:
    schema, data = vector("json", [1.0], 0)
    channels = {
        "/v": Channel(schema, "json"),
        "/flat": Channel(Schema("x.Y", "flatbuffer", b"bfbs", "flatbuffer"), "flatbuffer"),
        "/ros1": Channel(Schema("std_msgs/String", "ros1msg", b"string data", "ros1"), "ros1"),
        "/idl": Channel(Schema("a/msg/B", "ros2idl", b"module a {};", "cdr"), "cdr"),
        "/none": Channel(None, ""),
        "/bad": Channel(Schema("t.Bad", "protobuf", b"not a descriptor", "protobuf"), "protobuf"),
    }
    messages = [Message(topic, k, data if topic == "/v" else b"\1\2") for k in range(5) for topic in channels]
    write_messages(tmp_path / "a.mcap", channels, messages)
    episode = opened(tmp_path / "a.mcap")
    assert {s.name: s.kind for s in episode.streams.values()} == dict.fromkeys(channels, "other") | {"/v": "numeric"}
    texts = [str(problem) for problem in episode.problems]
    assert len(texts) == 5
    assert texts[0].startswith(
        "a.mcap, /flat: channel 2 cannot be read: its messages are 'flatbuffer' with 'flatbuffer' schemas. Record it, "
        "or convert it, as one of these: Protobuf (`protobuf`), ROS 2 CDR"
    )
    assert "its messages are 'ros1' with 'ros1msg' schemas" in texts[1]
    assert "its messages are 'cdr' with 'ros2idl' schemas" in texts[2]
    assert "its messages are 'of no declared encoding' with 'no' schemas" in texts[3]
    assert "the schema of t.Bad cannot be read" in texts[4]
    with pytest.raises(
        SourceError, match=r"/flat: it cannot be read: its messages are 'flatbuffer'.*Readable are: .*/v"
    ):
        episode.read(["/flat"])


def test_messages_that_do_not_decode_are_left_out_and_counted(tmp_path: Path) -> None:
    payloads = [b'{"v": %d}' % k if k not in (7, 8, 30) else b"{broken" for k in range(40)]
    channels = {"/v": Channel(json_schema("X"), "json")}
    write_messages(tmp_path / "a.mcap", channels, [Message("/v", k * 10**8, p) for k, p in enumerate(payloads)])
    episode = opened(tmp_path / "a.mcap")
    assert counts(episode) == {"/v": 37}
    (problem,) = episode.problems
    assert problem.where == "a.mcap, /v, message 7 at 0.700 s"
    assert problem.what.startswith("3 of 40 messages cannot be used and are left out; of the first, it is not JSON (")


def test_streams_whose_length_changes(tmp_path: Path) -> None:
    payloads = [
        b'{"v": [1, 2, 3]}',
        b'{"v": [1, 2]}',
        b'{"v": [1, 2, 3, 4]}',
        b'{"v": [1, 2, 3, 4, 5]}',
        b'{"v": [9, 9, 9]}',
    ]
    channels = {"/v": Channel(json_schema("X"), "json")}
    write_messages(tmp_path / "a.mcap", channels, [Message("/v", k, p) for k, p in enumerate(payloads)])
    episode = opened(tmp_path / "a.mcap")
    assert episode.streams["/v"].shape == (3,)
    (batch,) = episode.read()
    assert isinstance(batch, NumericBatch)
    np.testing.assert_array_equal(batch.values, [[1, 2, 3], [1, 2, np.nan], [1, 2, 3], [1, 2, 3], [9, 9, 9]])
    assert whats(episode) == [
        "its messages do not all have the same numbers; where 'v[2]' is missing it is NaN",
        "numbers that neither the first nor the last message has are left out, such as 'v[3]'",
    ]
