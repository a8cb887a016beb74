"""Q over time is one Rerun recording with the episode's video, on the same frames."""

import numpy as np

from jiti.critic.q_recording import write_q_recording
from jiti.episodes.reader import open_reader
from tests.builders.lerobot import write_v3


def test_values_and_video_are_one_recording_on_the_same_frames(tmp_path):
    import rerun as rr

    reader = open_reader(write_v3(tmp_path / "data", (12, 9)))
    episode = reader.open("episode_000001")
    q, returns = np.random.default_rng(0).normal(size=(2, 9)), np.arange(9.0)
    path = tmp_path / "out/q.rrd"
    write_q_recording(path, episode, q, returns, returns % 2, returns > 3)
    recorded = rr.experimental.RrdReader(path).store()
    entities = {str(column.entity_path) for column in recorded.schema().component_columns()}
    assert {"/critic/q", "/critic/mc_return", "/label/reward"} <= entities
    assert any("front" in entity for entity in entities)
    assert all(p.suffix == ".rrd" for p in path.parent.iterdir())
