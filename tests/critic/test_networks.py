"""What the networks promise: masks have no influence, candidates do not see each other, densities are densities."""

import pytest
import torch  # noqa: TID253  these tests are about tensors

from jiti.critic.networks import Actor, Normalize, QEnsemble, StackedLinear, Transformer

F, T, A, K, E, B, N = 6, 3, 2, 4, 2, 5, 3


@pytest.fixture
def q():
    torch.manual_seed(0)
    made = QEnsemble(Transformer(F, T, A, K, E, 8, 2, 2), F, 8, E)
    made.scale.fill_(3.0)
    return made


@pytest.fixture
def inputs():
    torch.manual_seed(1)
    return torch.randn(B, T, F), torch.rand(B, N, K, A) * 2 - 1, torch.ones(B, K, dtype=torch.bool)


def test_each_member_values_each_candidate_by_itself(q, inputs):
    features, chunks, mask = inputs
    values = q(features, chunks, mask)
    assert values.shape == (E, B, N)
    for n in range(N):
        torch.testing.assert_close(q(features, chunks[:, n : n + 1], mask)[:, :, 0], values[:, :, n])
    assert not torch.allclose(values[0], values[1])


def test_octaves_tell_apart_what_is_near(inputs):
    features, chunks, mask = inputs
    near = features + 1e-3

    def change(octaves):
        torch.manual_seed(0)
        q = QEnsemble(Transformer(F * (1 + 2 * octaves), T, A, K, E, 8, 2, 2), F, 8, E, octaves)
        return (q(near, chunks, mask) - q(features, chunks, mask)).abs().mean()

    assert change(8) > 5 * change(0)


def test_what_the_mask_leaves_out_has_no_influence_and_the_rest_has(q, inputs):
    features, chunks, mask = inputs
    cut = mask.clone()
    cut[:, 2:] = False
    other = chunks.clone()
    other[:, :, 2:] += 0.3
    torch.testing.assert_close(q(features, chunks, cut), q(features, other, cut))
    assert not torch.allclose(q(features, chunks, mask), q(features, other, mask))


def test_padding_tokens_have_no_influence_where_the_network_is_the_same(q, inputs):
    features, chunks, mask = inputs
    padded = features.clone()
    padded[:, 2] = 0
    q.normalize.mean.fill_(0.7)
    there = q.normalize(padded)
    assert there[1].tolist() == [[True, True, False]] * B
    assert not there[0][:, 2].any()
    with torch.no_grad():
        before = q(padded, chunks, mask)
        q.trunk.place[:, :, 2] += 5.0
        torch.testing.assert_close(q(padded, chunks, mask), before)


def test_members_share_nothing(q, inputs):
    q(*inputs)[0].sum().backward()
    for name, parameter in q.named_parameters():
        assert not parameter.grad[1].any(), name


def test_normalizing_gives_mean_zero_and_deviation_one_and_drops_constants():
    torch.manual_seed(0)
    features = torch.randn(500, 1, 3) * torch.tensor([5.0, 0.1, 0.0]) + 2
    normalize = Normalize(3)
    normalize.fit(features)
    scaled, _ = normalize(features)
    torch.testing.assert_close(scaled.mean((0, 1)), torch.zeros(3), atol=1e-4, rtol=0)
    torch.testing.assert_close(scaled.std((0, 1)), torch.tensor([1.0, 1.0, 0.0]), atol=5e-3, rtol=0)


def test_stacked_layers_equal_layers_one_by_one():
    torch.manual_seed(0)
    stacked, x = StackedLinear(E, 3, 4), torch.randn(E, 7, 3)
    for member in range(E):
        torch.testing.assert_close(stacked(x)[member], x[member] @ stacked.weight[member] + stacked.bias[member])


def test_the_density_of_a_single_number_integrates_to_one():
    torch.manual_seed(0)
    actor = Actor(F, 1, 1, 16)
    features, mask = torch.randn(1, 1, F), torch.ones(1, 1, dtype=torch.bool)
    points = torch.linspace(-0.9999, 0.9999, 20001).reshape(1, -1, 1, 1)
    density = actor.log_density(features, points, mask).exp()
    assert torch.trapezoid(density[0], points[0, :, 0, 0]).item() == pytest.approx(1, abs=2e-2)


def test_samples_have_the_density_that_is_asked_for_later():
    torch.manual_seed(0)
    actor = Actor(F, A, K, 16)
    features, mask = torch.randn(B, T, F), torch.ones(B, K, dtype=torch.bool)
    mask[:, 3] = False
    chunks, density = actor.sample(features, mask, torch.randn(B, N, K, A) * 0.5)
    torch.testing.assert_close(actor.log_density(features, chunks, mask), density, atol=1e-3, rtol=1e-3)
    base = torch.distributions.Normal(*(part for part in (actor(features)[0], actor(features)[1].exp())))
    whole = torch.distributions.TransformedDistribution(base, torch.distributions.TanhTransform())
    expected = (whole.log_prob(chunks[:, 0]) * mask[:, :, None]).sum((-1, -2))
    torch.testing.assert_close(density[:, 0], expected, atol=1e-3, rtol=1e-3)
