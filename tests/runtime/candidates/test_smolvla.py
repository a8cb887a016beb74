"""SmolVLA's prefix is computed once for all candidates and for the critic, and nothing comes out otherwise by that."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("num2words", reason="needs pip install num2words")

from jiti.critic.features import open_extractor  # noqa: E402
from jiti.runtime.candidates import check_pair, open_sampler, open_scorer  # noqa: E402
from jiti.runtime.candidates.observation import as_batch, shapes_of  # noqa: E402
from jiti.runtime.guidance import Guidance, Guide, noise  # noqa: E402
from tests.runtime.candidates.conftest import FRONT, TOLD, WRIST, observation, tiny_critic  # noqa: E402

# lerobot and transformers warn of their own dependencies, and take half a minute to import.
pytestmark = [pytest.mark.timeout(900), pytest.mark.filterwarnings("ignore")]


@pytest.fixture(scope="module")
def smolvla(tmp_path_factory):
    from tests.builders.tiny_smolvla import build_smolvla, build_vlm

    folder = tmp_path_factory.mktemp("models")
    return build_smolvla(folder / "smolvla", build_vlm(folder / "vlm"))


@pytest.fixture(scope="module")
def sampler(smolvla):
    return open_sampler(smolvla)


@pytest.fixture
def scorer(smolvla, tmp_path):
    return open_scorer(tiny_critic(tmp_path / "critic", features=f"smolvla:{smolvla}", tokens=4, size=32))


def seen_now(seed=0):
    return observation(seed, scene=0, cameras=(FRONT, WRIST))


def given(n, sampler, seed=0):
    return np.random.default_rng(seed).standard_normal((n, *sampler.noise_shape), dtype=np.float32)


@pytest.fixture
def crop_by_length(monkeypatch):
    """lerobot 0.6.1 asks for transformers below 5.6, whose `crop` took the length that is left."""
    from transformers import DynamicCache

    def crop(cache, length):
        for layer in cache.layers:
            layer.keys, layer.values = layer.keys[..., :length, :], layer.values[..., :length, :]

    monkeypatch.setattr(DynamicCache, "crop", crop)


def whole_policy(sampler, drawn):
    """Chunks of lerobot's own way: each through the whole policy."""
    batch = as_batch(seen_now(), TOLD)
    rows = []
    for row in drawn:
        prepared = sampler.base.preprocess(dict(batch))
        chunk = sampler.base.policy.predict_action_chunk(prepared, noise=torch.from_numpy(row)[None])
        rows.append(sampler.base.postprocess(chunk)[0].numpy())
    return np.stack(rows)


@pytest.mark.usefixtures("crop_by_length")
def test_chunks_are_those_of_the_whole_policy(sampler):
    drawn = given(8, sampler)
    chunks = sampler.observe(seen_now(), TOLD).sample(drawn)
    assert chunks.shape == (8, 10, 7)
    assert np.ptp(chunks, axis=0).min() > 1e-3
    assert np.allclose(chunks, whole_policy(sampler, drawn), atol=1e-5)


def test_a_chunk_follows_from_its_noise_whatever_the_batch_and_how_often_it_is_asked(sampler):
    drawn = given(8, sampler)
    seen = sampler.observe(seen_now(), TOLD)
    chunks = seen.sample(drawn)
    alone = np.concatenate([seen.sample(drawn[k : k + 1]) for k in range(8)])
    assert np.allclose(chunks, alone, atol=1e-5)
    assert np.allclose(sampler.observe(seen_now(), TOLD).sample(drawn[3:]), chunks[3:], atol=1e-5)


def test_many_candidates_are_drawn_in_groups(sampler, monkeypatch):
    import jiti.runtime.candidates.smolvla as module

    drawn = given(8, sampler)
    seen = sampler.observe(seen_now(), TOLD)
    chunks = seen.sample(drawn)
    monkeypatch.setattr(module, "_TOKENS_AT_ONCE", 30)
    assert np.allclose(seen.sample(drawn), chunks, atol=1e-5)


def test_first_actions_are_the_same_without_the_later_ones(sampler):
    drawn = given(8, sampler)
    few = sampler.only(4)
    assert few.chunk == 4
    assert few.noise_shape == sampler.noise_shape
    chunks = few.observe(seen_now(), TOLD).sample(drawn)
    assert chunks.shape == (8, 4, 7)
    assert np.allclose(chunks, sampler.observe(seen_now(), TOLD).sample(drawn)[:, :4], atol=1e-5)


@pytest.mark.parametrize("option", ["", "#all"])
def test_features_from_the_shared_prefix_are_those_of_the_extractor(sampler, smolvla, option):
    name = f"smolvla:{smolvla}{option}"
    extractor = open_extractor(name, shapes_of(seen_now()))
    features = extractor.features(as_batch(seen_now(), TOLD))
    seen = sampler.observe(seen_now(), TOLD)
    shared = seen.features(name)
    assert shared is not None
    assert shared.shape == (1, extractor.tokens, extractor.size)
    assert torch.allclose(shared, features, atol=1e-5)
    # Also behind the candidates, which went through the same cache.
    seen.sample(given(8, sampler))
    assert torch.equal(seen.features(name), shared)


@pytest.mark.usefixtures("crop_by_length")
def test_values_are_those_of_each_candidate_through_the_whole_policy_and_critic(sampler, scorer, smolvla):
    guide = Guide(Guidance("full"), 5, sampler.noise_shape)
    seen = sampler.observe(seen_now(), TOLD)
    chunk, decision = guide.decide(seen.sample, scorer.at(seen_now(), TOLD, seen))
    drawn = np.stack([noise(5, 0, k, sampler.noise_shape) for k in range(8)])
    chunks = whole_policy(sampler, drawn)
    features = open_extractor(f"smolvla:{smolvla}", shapes_of(seen_now())).features(as_batch(seen_now(), TOLD))
    naive = [float(scorer.critic.values(features, row[None, None]).min(0).values) for row in chunks]
    assert np.ptp(naive) > 1e-3
    assert np.allclose(decision.values, naive, atol=1e-4)
    assert decision.chosen == int(np.argmax(naive))
    assert np.allclose(chunk, chunks[decision.chosen], atol=1e-5)


def test_the_prefix_is_computed_once_a_decision(sampler, scorer, monkeypatch):
    model = sampler.base.policy.model
    pictures, kept = [], model.vlm_with_expert.embed_image
    monkeypatch.setattr(model.vlm_with_expert, "embed_image", lambda image: pictures.append(1) or kept(image))
    seen = sampler.observe(seen_now(), TOLD)
    Guide(Guidance("full"), 0, sampler.noise_shape).decide(seen.sample, scorer.at(seen_now(), TOLD, seen))
    assert len(pictures) == 2
    # No second policy was opened for the features.
    assert scorer._extractor is None


def test_one_candidate_is_the_default_whatever_the_method(sampler, scorer):
    found = []
    for guidance in (Guidance("none"), Guidance("jiti", candidates=1, tau=0.0), Guidance("full", candidates=1)):
        guide = Guide(guidance, 0, sampler.noise_shape)
        chunks = []
        for number in range(3):
            seen = sampler.observe(seen_now(number), TOLD)
            chunks.append(guide.decide(seen.sample, scorer.at(seen_now(number), TOLD, seen))[0])
        found.append(np.stack(chunks))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])


def test_a_pair_is_checked_with_the_features_that_are_shared(sampler, smolvla, tmp_path):
    from jiti.errors import JitiError

    check_pair(sampler, open_scorer(tiny_critic(tmp_path / "fits", features=f"smolvla:{smolvla}", tokens=4, size=32)))
    wrong = open_scorer(tiny_critic(tmp_path / "wrong", features=f"smolvla:{smolvla}", tokens=3, size=32))
    with pytest.raises(JitiError, match=r"\(3, 32\)"):
        check_pair(sampler, wrong, seen_now())


def test_without_names_in_common_pictures_are_taken_in_their_order(sampler):
    drawn, now = given(2, sampler), seen_now()
    other = {key.replace("front", "image").replace("wrist", "image2"): value for key, value in now.items()}
    chunks = sampler.observe(other, TOLD).sample(drawn)
    assert np.allclose(chunks, sampler.observe(now, TOLD).sample(drawn), atol=1e-6)
