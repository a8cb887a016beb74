"""Real recordings that others made."""

from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.episode import ImageBatch, numbers
from jiti.episodes.mcap_episode import McapEpisode
from jiti.episodes.mcap_reader import McapReader

EXPECTED = {
    "camera_json": {"/image/compressed": ("camera", 10)},
    "depthai_lz4": {"video": ("numeric", 124)},
    "franka_teleop": {
        "/robot_description": ("other", 1),
        "/tf": ("numeric", 5),
        "/robot_state": ("numeric", 4),
        "/joint_states": ("numeric", 4),
        "/action": ("numeric", 4),
        "/vr_controller": ("numeric", 4),
    },
    "g1_pick": {
        "/camera/front/compressed": ("camera", 393),
        "/joint_states": ("numeric", 393),
        "/command/joint_states": ("numeric", 393),
    },
    "rosbag2_split_0": {
        name: ("other", count)
        for name, count in zip(
            ["AAA", "BBB", "CCC", "DDD", "EEE", "FFF", "GGG", "HHH"],
            [174, 145, 157, 163, 147, 171, 141, 148],
            strict=True,
        )
    },
    "rosbag2_talker": {"/rosout": ("other", 10), "/topic": ("other", 10)},
}


def opened(shared: Path, name: str) -> McapEpisode:
    return McapReader(shared / "mcap" / f"{name}.mcap").open(name)


@pytest.mark.parametrize("name", EXPECTED)
def test_streams_and_counts(shared: Path, name: str) -> None:
    episode = opened(shared, name)
    found = {stream.name: (stream.kind, stream.count) for stream in episode.streams.values()}
    assert {topic: found[topic] for topic in EXPECTED[name]} == EXPECTED[name]
    given = dict.fromkeys(episode.streams, 0)
    for batch in episode.read():
        given[batch.stream] += len(batch.time_ns)
    for topic, stream in episode.streams.items():
        assert given[topic] == (stream.count if stream.kind != "other" else 0)


def test_the_pick_has_393_frames_at_30_hz(shared: Path) -> None:
    episode = opened(shared, "g1_pick")
    assert (episode.clock.reference, episode.clock.frame_count) == ("/camera/front/compressed", 393)
    assert episode.clock.rate_hz == pytest.approx(30, rel=1e-6)
    assert not episode.problems
    camera = episode.streams["/camera/front/compressed"]
    assert (camera.shape, camera.encoding) == ((240, 320, 3), "jpeg")
    assert sum(len(b.data) for b in episode.read([camera.name]) if isinstance(b, ImageBatch)) == 393
    times, values = numbers(episode, "/joint_states")
    assert (times == episode.clock.frame_ns).all()
    assert values.shape == (393, 26)
    assert np.isfinite(values).all()
    assert "kLeftElbow.position" in episode.streams["/joint_states"].names


def test_latched_topics_at_time_zero_do_not_make_it_55_years_long(shared: Path) -> None:
    episode = opened(shared, "franka_teleop")
    assert episode.clock.duration_ns == 1_500_000_000
    times, values = numbers(episode, "/joint_states")
    assert len(times) == 4
    assert values[-1, episode.streams["/joint_states"].names.index("fr3_joint2.position")] == pytest.approx(-0.785)


@pytest.mark.parametrize("name", ["rosbag2_split_0", "rosbag2_talker"])
def test_bags_without_pictures_or_numbers_open_and_say_so(shared: Path, name: str) -> None:
    episode = opened(shared, name)
    assert ["neither pictures nor numbers" in problem.what for problem in episode.problems] == [True]
    assert list(episode.read()) == []
