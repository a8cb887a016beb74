"""The scene's state of a recording is the one that policies see in simulation."""

import numpy as np
import pytest

from jiti.curate.export.outcome import recorded_success
from jiti.curate.export.scene import recorded_scene_state
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.scene_state import scene_state_names
from tests.builders.mcap import write_mcap


@pytest.mark.sim
@pytest.mark.parametrize("task_id", [pytest.param("elegant/T2", marks=pytest.mark.slow), "elegant/T3"])
def test_a_recording_gives_what_the_simulator_gives(tmp_path, task_id):
    pytest.importorskip("mujoco", reason="install jiti[sim]")
    from jiti.runtime.sim.proprio import scene_order, scene_vector
    from jiti.runtime.sim.record_episode import record_episode
    from jiti.runtime.sim.scene import CONTROL_HZ, Scene

    task = load_catalogue().task(task_id)
    scene = Scene(task, assets=None, graphics=None, cameras=())
    seen: list[np.ndarray] = []
    about = {"task": task_id, "rate_hz": str(CONTROL_HZ)}
    outcome = record_episode(
        tmp_path / "a.mcap", scene, seed=3, quality=1.0, start="jitter", about=about,
        progress=lambda _step: seen.append(scene_vector(scene, scene_order(scene))),
    )  # fmt: skip
    episode = open_reader(tmp_path / "a.mcap").open("a")
    found = recorded_scene_state(episode, task, "a.mcap")
    assert found.shape == (len(seen), len(scene_state_names()))
    if task_id == "elegant/T3":  # the knob is turned
        assert np.ptp(found[:, [name.endswith("joint_0") for name in scene_state_names()]], axis=0).max() > 0.1
    np.testing.assert_allclose(found, np.stack(seen), atol=1e-6)
    assert recorded_success(episode) is outcome.success


def test_a_recording_without_a_scene_is_refused(tmp_path):
    write_mcap(tmp_path / "a.mcap", cameras={})
    episode = open_reader(tmp_path / "a.mcap").open("a")
    assert recorded_success(episode) is None
    with pytest.raises(SourceError, match="Leave observation"):
        recorded_scene_state(episode, None, "a.mcap")
