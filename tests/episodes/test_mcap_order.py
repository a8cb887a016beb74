"""Messages out of order, equal times and clocks that jump: times never go back, nothing is lost, and it is said."""

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jiti.episodes.episode import ImageBatch, NumericBatch, numbers
from jiti.episodes.mcap_episode import McapEpisode
from tests.builders import mcap_messages
from tests.builders.encode import encode_numbered
from tests.builders.mcap import START_NS, Channel, Message, write_messages

SECOND = 10**9
CAMERA = Channel(mcap_messages.json_schema("foxglove.CompressedImage"), "json")
VIDEO = Channel(mcap_messages.json_schema("foxglove.CompressedVideo"), "json")
VALUES = Channel(mcap_messages.json_schema("X"), "json")


def number(topic: str, time_ns: int, value: float) -> Message:
    return Message(topic, time_ns, b'{"v": %r, "pad": "%s"}' % (float(value), b"x" * 60))


def picture(topic: str, time_ns: int, data: bytes, image: str = "jpeg") -> Message:
    return Message(topic, time_ns, mcap_messages.picture("json", image, 64, 48, time_ns, data)[1])


def frames(count: int) -> list[int]:
    return [START_NS + k * SECOND // 30 for k in range(count)]


def all_of(episode: McapEpisode, stream: str) -> tuple[list[int], list]:
    """Times and pictures or first values, with a check that times never go back, also across batches."""
    times, found = [], []
    for batch in episode.read():
        if batch.stream != stream:
            continue
        assert not times or batch.time_ns[0] >= times[-1]
        assert (np.diff(batch.time_ns) >= 0).all()
        times += batch.time_ns.tolist()
        found += list(batch.data) if isinstance(batch, ImageBatch) else batch.values[:, 0].tolist()
    return times, found


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), reach=st.sampled_from([1, 5, 60, 300]), chunk=st.sampled_from([300, 2000, 10**6]))
def test_any_disorder_comes_back_in_order_of_time(tmp_path: Path, seed: int, reach: int, chunk: int) -> None:
    rng = random.Random(seed)
    messages = [number("/a", t, k) for k, t in enumerate(frames(300))]
    messages += [number("/b", t + 5, k) for k, t in enumerate(frames(300)[::3])]
    messages.sort(key=lambda m: m.time_ns)
    messages.sort(key=lambda m: m.time_ns + rng.randrange(reach) * SECOND // 30)
    for k in range(1, len(messages), 50):  # equal times, in recording order
        messages.insert(k, Message(messages[k].topic, messages[k].time_ns, messages[k].data))
    write_messages(tmp_path / "a.mcap", {"/a": VALUES, "/b": VALUES}, messages, chunk_size=chunk)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    for topic in ("/a", "/b"):
        expected = sorted((m for m in messages if m.topic == topic), key=lambda m: m.time_ns)
        times, values = all_of(episode, topic)
        if any("clock jumps" in p.what for p in episode.problems):
            continue  # messages late by more than half a second look like it; nothing may be lost then either
        assert times == [m.time_ns for m in expected]
        assert values == [float(m.data[6 : m.data.index(b",")]) for m in expected]
    total = sum(len(b.time_ns) for b in episode.read())
    assert total == len(messages)


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (3, 2, 1, 0), (0, 2, 1, 3)])
def test_stretches_out_of_order_across_chunks(tmp_path: Path, order: tuple[int, ...]) -> None:
    pictures = encode_numbered(range(120), "jpeg", 64, 48)
    every = [picture("/cam", t, data) for t, data in zip(frames(120), pictures, strict=True)]
    every += [number("/a", t, k) for k, t in enumerate(frames(120))]
    every.sort(key=lambda m: m.time_ns)
    parts = [every[k * 60 : k * 60 + 60] for k in range(4)]
    messages = [m for k in order for m in parts[k]]
    write_messages(tmp_path / "a.mcap", {"/cam": CAMERA, "/a": VALUES}, messages, chunk_size=10_000)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    assert all_of(episode, "/cam") == (frames(120), pictures)
    assert all_of(episode, "/a") == (frames(120), [float(k) for k in range(120)])
    assert (episode.clock.frame_ns == frames(120)).all()
    assert [p.where for p in episode.problems] == ["a.mcap, /cam", "a.mcap, /a"]
    assert all("are out of order in" in p.what for p in episode.problems)


def test_topics_that_are_written_one_after_another(tmp_path: Path) -> None:
    messages = [number(topic, t, k) for topic in ("/a", "/b", "/c") for k, t in enumerate(frames(200))]
    write_messages(tmp_path / "a.mcap", dict.fromkeys(("/a", "/b", "/c"), VALUES), messages, chunk_size=3000)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    assert list(episode.problems) == []
    newest: dict[str, int] = dict.fromkeys(["/a", "/b", "/c"], START_NS)
    for batch in episode.read():
        newest[batch.stream] = int(batch.time_ns[-1])
        assert max(newest.values()) - min(newest.values()) < 2 * SECOND  # chunks are taken in order of time


def test_video_stays_in_recording_order(tmp_path: Path) -> None:
    pictures = encode_numbered(range(60), "h264", 64, 48)
    times = frames(60)
    times[20], times[21] = times[21], times[20]
    messages = [picture("/cam", t, data, "h264") for t, data in zip(times, pictures, strict=True)]
    write_messages(tmp_path / "a.mcap", {"/cam": VIDEO}, messages, chunk_size=1000)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    found, data = all_of(episode, "/cam")
    assert data == pictures
    assert found == [*times[:21], times[20], *times[22:]]
    (problem,) = episode.problems
    assert "1 of its pictures are stamped earlier than one before, by up to 0.033 s" in problem.what


def test_a_video_picture_that_is_very_late_stays_where_it_decodes(tmp_path: Path) -> None:
    pictures = encode_numbered(range(60), "h264", 64, 48)
    times = frames(60)
    times[40] = times[10] + 1
    messages = [picture("/cam", t, data, "h264") for t, data in zip(times, pictures, strict=True)]
    write_messages(tmp_path / "a.mcap", {"/cam": VIDEO}, messages, chunk_size=1000)
    assert all_of(McapEpisode(tmp_path / "a.mcap", "a"), "/cam") == ([*times[:40], times[39], *times[41:]], pictures)


def test_stretches_of_video_out_of_order_are_put_in_order_and_left_as_they_are(tmp_path: Path) -> None:
    pictures = encode_numbered(range(120), "h264", 64, 48, gop=30)
    times = frames(120)
    times[70], times[71] = times[71], times[70]
    every = [picture("/cam", t, data, "h264") for t, data in zip(times, pictures, strict=True)]
    messages = [*every[60:90], *every[:60], *every[90:]]
    write_messages(tmp_path / "a.mcap", {"/cam": VIDEO}, messages, chunk_size=1000)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    assert all_of(episode, "/cam") == ([*times[:71], times[70], *times[72:]], pictures)
    first, second = (p.what for p in episode.problems)
    assert first.startswith("its pictures are recorded in stretches that are out of order")
    assert "are shown at the time of the latest before them" in second


@pytest.mark.parametrize("image", ["jpeg", "h264"])
@pytest.mark.parametrize("back_s", [5, 100, 10**6])
def test_a_clock_that_jumps_back(tmp_path: Path, image: str, back_s: int) -> None:
    pictures = encode_numbered(range(90), image, 64, 48)
    true = frames(90)
    stamped = [t - back_s * SECOND if k >= 50 else t for k, t in enumerate(true)]
    joints = [START_NS + k * SECOND // 100 for k in range(300)]
    joint_stamps = [t - back_s * SECOND if t >= true[50] else t for t in joints]
    messages = [(t, picture("/cam", s, d, image)) for t, s, d in zip(true, stamped, pictures, strict=True)]
    messages += [(t, number("/a", s, k)) for k, (t, s) in enumerate(zip(joints, joint_stamps, strict=True))]
    messages.sort(key=lambda item: item[0])
    channels = {"/cam": CAMERA if image == "jpeg" else VIDEO, "/a": VALUES}
    write_messages(tmp_path / "a.mcap", channels, [m for _, m in messages], chunk_size=5000)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    times, data = all_of(episode, "/cam")
    assert data == pictures
    # Both go on by the same amount: right to within one period of the denser stream.
    assert np.abs(np.array(times) - true).max() <= SECOND / 100
    found, values = all_of(episode, "/a")
    assert values == [float(k) for k in range(300)]
    assert np.abs(np.array(found) - joints).max() <= SECOND / 100
    assert (episode.clock.frame_ns == times).all()
    texts = [str(problem) for problem in episode.problems]
    assert len(texts) == 2
    assert f"a.mcap, /cam: its clock jumps back by {back_s - 1 / 30:.3f} s at message 50; its times go on" in texts[0]
    assert f"a.mcap, /a: its clock jumps back by {back_s - 0.01:.3f} s at message 167;" in texts[1]


def test_equal_times_keep_their_recording_order(tmp_path: Path) -> None:
    messages = [number("/a", START_NS + k // 4 * SECOND, k) for k in range(40)]
    write_messages(tmp_path / "a.mcap", {"/a": VALUES}, messages, chunk_size=500)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    times, values = numbers(episode, "/a")
    assert values[:, 0].tolist() == list(range(40))
    assert times.tolist() == [m.time_ns for m in messages]
    assert list(episode.problems) == []


def test_little_is_held_back_where_one_message_is_late(tmp_path: Path) -> None:
    """One early message at the end of the file does not make the reader keep all that came before it."""
    times = frames(3000)
    messages = [number("/a", t, k) for k, t in enumerate(times)]
    messages = [*messages[:10], *messages[11:], messages[10]]
    messages += [number("/a", times[-1] + (k + 1) * SECOND // 30, 3000 + k) for k in range(10)]
    write_messages(tmp_path / "a.mcap", {"/a": VALUES}, messages, chunk_size=3000)
    episode = McapEpisode(tmp_path / "a.mcap", "a")
    batches = [b for b in episode.read() if isinstance(b, NumericBatch)]
    assert np.concatenate([b.values[:, 0] for b in batches]).tolist() == list(range(3010))
    assert max(len(b.time_ns) for b in batches) < 200
