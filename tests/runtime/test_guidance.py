"""JITI on a policy and a critic that are arithmetic: when it looks, what it takes, and what it costs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.errors import UsageError
from jiti.runtime.guidance import Decision, Guidance, Guide, calibrated_tau, noise

SHAPE = (10, 7)


class World:
    """Chunks are their noise plus the time; the critic sums up what it is told to."""

    def __init__(self, value=lambda chunks, step: chunks.sum((1, 2))):
        self.value, self.step, self.sampled, self.scored = value, 0, 0, 0

    def sample(self, given_noise):
        self.sampled += len(given_noise)
        return given_noise + self.step

    def score(self, chunks):
        self.scored += len(chunks)
        return self.value(chunks, self.step)

    def play(self, guidance: Guidance, steps: int = 12, seed: int = 3) -> tuple[np.ndarray, list[Decision]]:
        guide, chunks, decisions = Guide(guidance, seed, SHAPE), [], []
        for self.step in range(steps):
            chunk, decision = guide.decide(self.sample, self.score)
            chunks.append(chunk)
            decisions.append(decision)
        return np.array(chunks), decisions


def test_with_one_candidate_all_methods_do_the_same():
    plays = [World().play(Guidance(m, candidates=1, tau=0.0))[0] for m in ("none", "jiti", "full")]
    np.testing.assert_array_equal(plays[0], plays[1])
    np.testing.assert_array_equal(plays[0], plays[2])


def test_the_default_path_costs_one_sample_and_one_evaluation():
    quiet = World()
    quiet.play(Guidance("jiti", tau=np.inf), steps=10)
    assert (quiet.sampled, quiet.scored) == (10, 10)
    alone = World()
    alone.play(Guidance("none"), steps=10)
    assert (alone.sampled, alone.scored) == (10, 0)
    busy = World()
    busy.play(Guidance("full", candidates=8), steps=10)
    assert (busy.sampled, busy.scored) == (80, 80)


def test_it_looks_only_where_the_value_leaves_the_mean_of_those_before():
    jump = World(lambda chunks, step: np.full(len(chunks), 1.0 if step < 6 else 3.0))
    _, decisions = jump.play(Guidance("jiti", window=4, tau=0.9))
    assert [d.decision for d in decisions if d.triggered] == [6, 7, 8]
    assert np.isnan(decisions[0].q_bar)
    assert [decisions[k].q_bar for k in (6, 7, 8, 9)] == [1, 1.5, 2, 2.5]
    assert decisions[7].delta_q == 1.5
    assert not decisions[5].values


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31), st.integers(2, 9))
def test_picks_are_the_ranks_of_the_values(seed, candidates):
    for pick, rank in (("best", -1), ("median", candidates // 2), ("worst", 0)):
        chunks, decisions = World().play(Guidance("full", pick, candidates), steps=2, seed=seed)
        for chunk, decision in zip(chunks, decisions, strict=True):
            assert len(decision.values) == candidates
            assert decision.values[decision.chosen] == sorted(decision.values)[rank]
            assert chunk.sum() == pytest.approx(decision.values[decision.chosen], rel=1e-4, abs=1e-3)


def test_methods_share_their_noise_and_a_random_pick_triggers_where_jiti_does():
    full = World().play(Guidance("full"))[1]
    few = World().play(Guidance("full", candidates=3))[1]
    assert all(b.values == a.values[:3] for a, b in zip(full, few, strict=True))
    assert noise(1, 2, 3, SHAPE).tobytes() == noise(1, 2, 3, SHAPE).tobytes()
    seen = {noise(*key, SHAPE).tobytes() for key in np.ndindex(3, 3, 3)}
    assert len(seen) == 27
    jiti = World().play(Guidance("jiti", tau=5.0))[1]
    random = World().play(Guidance("jiti", "random", tau=5.0))[1]
    assert [d.triggered for d in jiti] == [d.triggered for d in random]
    assert any(d.triggered for d in jiti)
    assert len({d.chosen for d in random if d.triggered}) > 1


def test_no_noise_is_the_stream_of_a_scene_or_of_fewer_seeds():
    for seed, decision in np.ndindex(20, 4):
        first = noise(seed, decision, 0, SHAPE)
        for other in ([seed], [seed, 0], [seed, decision], [seed, decision, 0]):
            drawn = np.random.default_rng(other).standard_normal(SHAPE, dtype=np.float32)
            assert not np.array_equal(first, drawn)


def test_the_random_pick_does_not_depend_on_the_noise_of_the_default():
    values, chosen, size = np.arange(8.0), [], []
    for seed in range(400):
        guide = Guide(Guidance("full", "random"), seed, SHAPE)
        _, decision = guide.decide(lambda given: given, lambda chunks: values[: len(chunks)])
        chosen.append(decision.chosen)
        size.append(abs(float(noise(seed, 0, 0, SHAPE)[0, 0])))
    assert abs(np.corrcoef(chosen, size)[0, 1]) < 0.15
    assert np.bincount(chosen, minlength=8).min() > 400 / 8 / 2


@pytest.mark.parametrize("guidance", [Guidance("full"), Guidance("jiti", tau=0.0)])
@pytest.mark.parametrize("broken", [0, 3])
def test_a_critic_without_a_number_leaves_the_default_and_is_told(broken, guidance):
    def value(chunks, step):
        values = chunks.sum((1, 2))
        lost = noise(3, 5, broken, SHAPE) + 5
        values[[np.array_equal(chunk, lost) for chunk in chunks]] = np.nan
        return values

    chunks, decisions = World(value).play(guidance)
    default = World().play(Guidance("none"))[0]
    np.testing.assert_array_equal(chunks[5], default[5])
    assert decisions[5].chosen == 0
    assert "no number" in decisions[5].problem
    assert not any(d.problem for d in decisions if d.decision != 5)
    assert np.isfinite([d.q_bar for d in decisions[6:]]).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 0.6))
def test_tau_triggers_at_the_rate_that_was_asked_for(seed, rate):
    delta_q = np.random.default_rng(seed).exponential(size=(40, 20))
    delta_q[:, 0] = np.nan
    tau = calibrated_tau(delta_q.ravel(), rate)
    assert np.mean(delta_q > tau) == pytest.approx(rate, abs=0.01)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Guidance("jiti"), "--tau"),
        (lambda: Guidance("jiti", tau=float("nan")), "--tau"),
        (lambda: Guidance("full", candidates=0), "--candidates"),
        (lambda: Guidance("full", window=0), "--window"),
        (lambda: calibrated_tau(np.ones(3), 1.5), "0.339"),
        (lambda: calibrated_tau(np.full(3, np.nan), 0.3), "play some"),
    ],
)
def test_what_cannot_be_is_refused(make, told):
    with pytest.raises(UsageError, match=told):
        make()
