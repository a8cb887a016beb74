"""Chunks follow from their noise alone, in the robot's units."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.errors import UsageError
from jiti.runtime.candidates import open_sampler
from jiti.runtime.candidates.observation import as_batch
from jiti.runtime.candidates.opened import OpenedBase
from tests.runtime.candidates.conftest import FRONT, SCENE, STATE, TOLD, WRIST, inputs, observation

# lerobot warns of its own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def sampler(flow):
    return open_sampler(flow)


def noise(n: int, shape, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, *shape), dtype=np.float32)


def test_a_chunk_follows_from_its_noise_whatever_the_batch(sampler):
    given = noise(8, sampler.noise_shape)
    seen = sampler.observe(observation(), TOLD)
    chunks = seen.sample(given)
    assert chunks.shape == (8, 10, 7)
    assert chunks.dtype == np.float32
    assert np.ptp(chunks, axis=0).min() > 1e-3
    alone = np.concatenate([seen.sample(given[k : k + 1]) for k in range(8)])
    assert np.allclose(chunks, alone, atol=1e-5)
    assert np.allclose(seen.sample(given[::-1].copy())[::-1], chunks, atol=1e-5)
    assert np.array_equal(sampler.observe(observation(), TOLD).sample(given), chunks)


def test_chunks_are_those_of_the_policys_own_pipelines(sampler):
    import torch

    given = noise(3, sampler.noise_shape)
    base = sampler.base
    batch = {k: torch.from_numpy(v) for k, v in observation().items()} | {"task": TOLD}
    prepared = base.preprocess(batch)
    for row, chunk in zip(given, sampler.observe(observation(), TOLD).sample(given), strict=True):
        by_hand = base.postprocess(base.policy.predict_action_chunk(prepared, torch.from_numpy(row)[None]))
        assert np.allclose(by_hand[0].numpy(), chunk, atol=1e-5)


def test_torchs_random_numbers_are_left_as_they_were(flow):
    import torch

    before = torch.get_rng_state()
    sampler = open_sampler(flow)
    sampler.observe(observation(), TOLD).sample(noise(2, sampler.noise_shape))
    assert torch.equal(torch.get_rng_state(), before)


def test_observations_and_instructions_make_a_difference(sampler):
    given = noise(2, sampler.noise_shape)
    chunks = sampler.observe(observation(), TOLD).sample(given)
    assert not np.allclose(chunks, sampler.observe(observation(1), TOLD).sample(given))
    assert not np.allclose(chunks, sampler.observe(observation(), "push it away").sample(given))


def test_what_was_seen_is_not_changed_by_a_later_observation(sampler):
    given = noise(2, sampler.noise_shape)
    first, values = observation(), {}
    seen = sampler.observe(first, TOLD)
    values["before"] = seen.sample(given)
    sampler.observe(observation(1), TOLD).sample(given)
    first[STATE][:] = 9
    assert np.array_equal(seen.sample(given), values["before"])


def test_what_does_not_fit_is_refused(sampler):
    whole = observation()
    with pytest.raises(UsageError, match=r"environment_state of shape \(5,\), and here it is not among"):
        sampler.observe({STATE: whole[STATE]}, TOLD)
    with pytest.raises(UsageError, match=r"observation\.state of shape \(8,\), and here it is of \(3,\)"):
        sampler.observe({STATE: np.zeros(3), SCENE: whole[SCENE]}, TOLD)
    with pytest.raises(UsageError, match=r"noise has the shape \(10, 7\)"):
        sampler.observe(whole, TOLD).sample(np.zeros((10, 7), np.float32))


@pytest.mark.parametrize(
    ("wanted", "empty", "cameras", "said"),
    [
        ((FRONT, WRIST), 0, (FRONT,), f"trained with {WRIST}, not among {FRONT}"),
        (("observation.images.camera1", "observation.images.camera2"), 0, (FRONT,), "images.camera2, not among"),
        ((FRONT, WRIST), 0, (), "and there are none"),
        ((FRONT, WRIST, "observation.images.empty_camera_0"), 1, (FRONT,), WRIST),
        ((FRONT, "observation.images.empty_camera_0"), 1, (FRONT,), ""),
        ((FRONT,), 0, (FRONT, WRIST), ""),
    ],
)
def test_a_camera_that_the_policy_looks_at_is_not_left_out(wanted, empty, cameras, said):
    features = inputs(scene=0, cameras=wanted)["input_features"]
    looks = {key: features[key] for key in wanted}
    config = SimpleNamespace(input_features=features, image_features=looks, empty_cameras=empty)
    policy: Any = SimpleNamespace(config=config)
    base = OpenedBase(policy, None, None, Path("run"))
    batch = as_batch(observation(scene=0, cameras=cameras), TOLD)
    if said:
        with pytest.raises(UsageError, match=said):
            base.renamed(batch)
    else:
        assert set(base.renamed(batch)) == {STATE, FRONT, "task"}


def test_what_is_no_policy_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"config\.json"):
        open_sampler(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps({"type": "gpt"}))
    with pytest.raises(UsageError, match="gpt"):
        open_sampler(tmp_path)


def test_a_policy_without_stochastic_chunks_is_refused(tmp_path):
    from lerobot.policies.act.configuration_act import ACTConfig

    ACTConfig(device="cpu", push_to_hub=False, **inputs()).save_pretrained(tmp_path)
    with pytest.raises(UsageError, match="type act, which is not known to draw different chunks"):
        open_sampler(tmp_path)


def test_relative_actions_are_added_to_the_observation_that_they_are_of(sampler, monkeypatch):
    """Whichever was prepared last: a pipeline of lerobot's may keep the last state for its other end."""
    base, kept = sampler.base, {}
    before, after = base.preprocess, base.postprocess

    def keeping(batch):
        kept["state"] = batch[STATE][0, 0]
        return before(batch)

    monkeypatch.setattr(base, "preprocess", keeping)
    monkeypatch.setattr(base, "postprocess", lambda chunks: after(chunks) + kept["state"])
    given, (one, other) = noise(2, sampler.noise_shape), (observation(0), observation(1))
    first, second = sampler.observe(one, TOLD), sampler.observe(other, TOLD)
    chunks = first.sample(given)
    second.sample(given)
    assert np.array_equal(first.sample(given), chunks)
    monkeypatch.undo()
    assert np.allclose(chunks - one[STATE][0], sampler.observe(one, TOLD).sample(given), atol=1e-5)
