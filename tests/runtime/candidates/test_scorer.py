"""Values of candidates are the least of the critic's members, on features that are computed once."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.errors import SourceError, UsageError
from jiti.runtime.candidates import check_pair, open_sampler, open_scorer
from jiti.runtime.guidance import Guidance, Guide
from tests.runtime.candidates.conftest import SCENE, STATE, TOLD, observation, tiny_critic

# lerobot warns of its own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def sampler(flow):
    return open_sampler(flow)


@pytest.fixture
def scorer(critic):
    return open_scorer(critic)


def decide(sampler, scorer, guidance, seed=0, observations=4):
    guide = Guide(guidance, seed, sampler.noise_shape)
    chunks, decisions = [], []
    for number in range(observations):
        seen = sampler.observe(observation(number), TOLD)
        chunk, decision = guide.decide(seen.sample, scorer.at(observation(number), TOLD, seen))
        chunks.append(chunk)
        decisions.append(decision)
    return np.stack(chunks), decisions


def test_values_are_those_of_the_critic_itself(sampler, scorer):
    import torch

    chunks = np.random.default_rng(0).normal(size=(5, 10, 7)).astype(np.float32)
    values = scorer.at(observation(), TOLD)(chunks)
    assert values.shape == (5,)
    features = torch.from_numpy(np.concatenate([observation()[STATE], observation()[SCENE]]))[None, None]
    by_hand = scorer.critic.values(features, chunks[None])
    assert by_hand.shape == (2, 1, 5)
    assert np.allclose(values, by_hand.min(0).values[0].numpy(), atol=1e-6)
    assert np.ptp(values) > 0.01


def test_a_chunk_that_is_longer_than_the_critics_is_valued_by_its_beginning(scorer):
    chunks = np.random.default_rng(0).normal(size=(5, 14, 7)).astype(np.float32)
    score = scorer.at(observation(), TOLD)
    assert np.array_equal(score(chunks), score(chunks[:, :10]))


def test_features_are_computed_once_a_decision_and_never_without_guidance(sampler, scorer):
    asked = []
    whole = scorer.extractor(observation())
    kept = whole.features
    whole.features = lambda batch: asked.append(1) or kept(batch)
    decide(sampler, scorer, Guidance("none"))
    assert len(asked) == 0
    decide(sampler, scorer, Guidance("full"))
    assert len(asked) == 4


def test_one_candidate_is_the_default_whatever_the_method(sampler, scorer):
    none, _ = decide(sampler, scorer, Guidance("none"))
    jiti, decisions = decide(sampler, scorer, Guidance("jiti", candidates=1, tau=0.0))
    full, _ = decide(sampler, scorer, Guidance("full", candidates=1))
    assert np.array_equal(none, jiti)
    assert np.array_equal(none, full)
    assert any(d.triggered for d in decisions)


def test_values_of_candidates_are_those_of_each_alone(sampler, scorer):
    from jiti.runtime.guidance import noise

    _, decisions = decide(sampler, scorer, Guidance("full"), seed=3)
    for decision in decisions:
        assert len(decision.values) == 8
        for candidate, value in enumerate(decision.values):
            drawn = noise(3, decision.decision, candidate, sampler.noise_shape)[None]
            chunk = sampler.observe(observation(decision.decision), TOLD).sample(drawn)
            alone = scorer.at(observation(decision.decision), TOLD)(chunk)
            assert alone[0] == pytest.approx(value, abs=1e-4)


def test_the_same_seed_gives_the_same_chunks(sampler, scorer):
    first, _ = decide(sampler, scorer, Guidance("full"), seed=1)
    again, _ = decide(sampler, scorer, Guidance("full"), seed=1)
    other, _ = decide(sampler, scorer, Guidance("full"), seed=2)
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_what_does_not_fit_together_is_told_before_anything_is_done(sampler, scorer, tmp_path):
    check_pair(sampler, scorer)
    check_pair(sampler, scorer, observation())
    longer = open_scorer(tiny_critic(tmp_path / "longer", chunk=12))
    with pytest.raises(UsageError, match="chunks of 12 actions, and the policy gives 10"):
        check_pair(sampler, longer)
    wider = open_scorer(tiny_critic(tmp_path / "wider", size=14))
    with pytest.raises(UsageError, match="1 x 14 numbers, and state gives 1 x 13"):
        check_pair(sampler, wider, observation())
    with pytest.raises(UsageError, match="there is no such folder"):
        open_scorer(tiny_critic(tmp_path / "gone", features="policy:not a name"))
    with pytest.raises(SourceError, match="no critic"):
        open_scorer(tmp_path)
    (tmp_path / "config.json").write_text('{"type": "state_flow"}')
    with pytest.raises(SourceError, match=r"no critic: its config\.json is of something else"):
        open_scorer(tmp_path)


def test_features_of_other_observations_than_it_learned_from_are_refused(sampler, tmp_path):
    from jiti.critic.features import open_extractor
    from jiti.runtime.candidates.observation import shapes_of

    own = open_extractor("state", shapes_of(observation())).fingerprint
    check_pair(sampler, open_scorer(tiny_critic(tmp_path / "own", fingerprint=own)), observation())
    # As many numbers in all, 9 of the robot and 4 of the scene.
    other = open_extractor("state", {STATE: (9,), SCENE: (4,)}).fingerprint
    with pytest.raises(UsageError, match="learned from state of other observations"):
        check_pair(sampler, open_scorer(tiny_critic(tmp_path / "other", fingerprint=other)), observation())
