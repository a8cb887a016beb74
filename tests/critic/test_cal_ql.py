"""Each term by itself: against numbers worked out by hand, against finite differences, and where gradients stop."""

import math

import pytest
import torch  # noqa: TID253  these tests are about tensors
from torch.autograd import gradcheck  # noqa: TID253

from jiti.critic.cal_ql import (
    MULTIPLIER_LIMIT,
    actor_loss,
    bellman_loss,
    calibrated,
    clamped,
    conservative_term,
    conservative_term_public,
    critic_loss,
    multiplier_loss,
    soft_update,
    td_target,
    temperature_loss,
)

MEMBERS, STATES, CHUNKS, RANDOM = 2, 3, 3, 2


def tensor(*shape: int, seed: int = 0, gradient: bool = True) -> torch.Tensor:
    made = torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return made.requires_grad_(gradient)


def test_the_target_is_the_reward_and_the_discounted_least_member():
    next_q = torch.tensor([[[3.0, 5.0]], [[4.0, 1.0]]])
    reward, discount = torch.tensor([2.0]), torch.tensor([0.5])
    assert td_target(reward, discount, next_q).tolist() == [2 + 0.5 * (3 + 1) / 2]
    assert td_target(reward, discount, next_q, backup="max").tolist() == [2 + 0.5 * 3]
    assert td_target(reward, torch.zeros(1), next_q).tolist() == [2]


def test_bellman_loss_sums_members_and_averages_states():
    q, target = torch.tensor([[1.0, 2.0], [3.0, 4.0]]), torch.tensor([0.0, 2.0])
    assert bellman_loss(q, target).item() == (1 + 0) / 2 + (9 + 4) / 2


def test_the_bound_holds_each_value_above_the_return():
    q, v_mu = torch.tensor([[1.0, 5.0], [2.0, 2.0]]), torch.tensor([1.5, 3.0])
    bounded, active = calibrated(q, v_mu)
    assert bounded.tolist() == [[1.5, 5.0], [2.0, 3.0]]
    assert active.item() == 0.5


def test_conservative_term_compares_the_mean_with_the_return():
    q_policy = torch.tensor([[[0.0, 4.0], [1.0, 1.0]]])
    q_data, v_mu = torch.tensor([[1.0, 1.0]]), torch.tensor([1.0, 3.0])
    term, active = conservative_term(q_policy, q_data, v_mu)
    assert term.item() == ((2 - 1) + (3 - 1)) / 2
    assert active.item() == 0.5
    assert conservative_term(q_policy, q_data, v_mu, calibrate=False)[0].item() == ((2 - 1) + (1 - 1)) / 2


def test_the_public_term_bounds_each_policy_value_and_no_random_one():
    q_policy, q_random = torch.tensor([[[1.0]]]), torch.tensor([[[2.0]]])
    q_data, v_mu = torch.tensor([[0.5]]), torch.tensor([5.0])
    density, volume = torch.tensor([[0.3]]), torch.tensor([[-0.7]])
    term, active = conservative_term_public(q_policy, q_random, q_data, v_mu, density, volume)
    assert term.item() == pytest.approx(math.log(math.exp(5 - 0.3) + math.exp(2 + 0.7)) - 0.5)
    assert active.item() == 1


def test_gradients_equal_finite_differences():
    q, target = tensor(MEMBERS, STATES), tensor(STATES, seed=1, gradient=False)
    v_mu = tensor(STATES, seed=2, gradient=False)
    policy, random = tensor(MEMBERS, STATES, CHUNKS, seed=3), tensor(MEMBERS, STATES, RANDOM, seed=4)
    density, volume = tensor(STATES, CHUNKS, seed=5, gradient=False), tensor(STATES, RANDOM, seed=6, gradient=False)
    scalar, log_density = tensor(1, seed=7), tensor(STATES, CHUNKS, seed=8)
    fixed = log_density.detach()
    assert gradcheck(lambda q: bellman_loss(q, target), (q,))
    assert gradcheck(lambda p: calibrated(p, v_mu)[0], (policy,))
    assert gradcheck(lambda p, q: conservative_term(p, q, v_mu)[0], (policy, q))
    assert gradcheck(lambda p, q: conservative_term(p, q, v_mu, calibrate=False)[0], (policy, q))
    assert gradcheck(lambda p, r, q: conservative_term_public(p, r, q, v_mu, density, volume)[0], (policy, random, q))
    assert gradcheck(
        lambda p, q: critic_loss(bellman_loss(q, target), conservative_term(p, q, v_mu)[0], 5.0), (policy, q)
    )
    assert gradcheck(lambda d, p: actor_loss(d, p, torch.tensor(0.3)), (log_density, policy))
    assert gradcheck(lambda s: temperature_loss(s, fixed, -7.0), (scalar,))
    assert gradcheck(lambda s: multiplier_loss(s, torch.tensor(1.2), 5.0, 0.5), (scalar,))


def test_gradients_stop_where_the_docstrings_say():
    q, target, v_mu = tensor(MEMBERS, STATES), tensor(STATES, seed=1), tensor(STATES, seed=2)
    policy, random = tensor(MEMBERS, STATES, CHUNKS, seed=3), tensor(MEMBERS, STATES, RANDOM, seed=4)
    density, volume = tensor(STATES, CHUNKS, seed=5), tensor(STATES, RANDOM, seed=6)
    temperature, multiplier = tensor(1, seed=7), tensor(1, seed=8)
    assert not td_target(target, target, policy).requires_grad
    (
        bellman_loss(q, target)
        + conservative_term_public(policy, random, q, v_mu, density, volume)[0]
        + critic_loss(bellman_loss(q, target), conservative_term(policy, q, v_mu)[0], multiplier.exp(), gap=0.5).sum()
        + actor_loss(density.detach(), policy, temperature)
    ).backward()
    assert [x.grad is None for x in (target, v_mu, density, volume, temperature, multiplier)] == [True] * 6
    temperature_loss(temperature, density, -7.0).backward()
    multiplier_loss(multiplier, conservative_term(policy, q, v_mu)[0], 5.0, 0.5).backward()
    assert density.grad is None


def test_a_value_under_the_return_is_not_pushed_down_further():
    policy, v_mu = tensor(MEMBERS, STATES, CHUNKS), torch.full((STATES,), 100.0, dtype=torch.float64)
    conservative_term(policy, tensor(MEMBERS, STATES, seed=1), v_mu)[0].backward()
    assert policy.grad is not None
    assert not policy.grad.any()


def test_the_multiplier_grows_above_the_gap_and_shrinks_under_it():
    for term, sign in ((1.0, 1), (0.1, -1)):
        log_multiplier = torch.zeros(1, requires_grad=True)
        multiplier_loss(log_multiplier, torch.tensor(term), 5.0, 0.5).backward()
        assert log_multiplier.grad is not None
        assert (-log_multiplier.grad * sign).item() > 0


def test_two_members_alike_have_the_gap_and_the_multiplier_of_one():
    one, two = torch.tensor(0.7), torch.tensor(1.4)  # R_cal of a member, and the sum over two such members
    log_multiplier = torch.tensor(0.3)
    assert multiplier_loss(log_multiplier, one, 5.0, 0.5).item() == pytest.approx(-math.exp(0.3) * 5 * 0.2)
    alike = multiplier_loss(log_multiplier, two, 5.0, 0.5, members=2)
    torch.testing.assert_close(alike, multiplier_loss(log_multiplier, one, 5.0, 0.5))
    bellman = torch.tensor(3.0)
    assert critic_loss(bellman, two, 5.0, gap=0.5, members=2).item() == pytest.approx(3 + 2 * 5 * 0.2)


def test_the_multiplier_ends_at_its_limit():
    huge = torch.tensor(50.0, requires_grad=True)
    assert clamped(huge).item() == MULTIPLIER_LIMIT
    assert multiplier_loss(huge, torch.tensor(1.0), 5.0, 0.5).item() == -MULTIPLIER_LIMIT * 2.5


def test_the_target_network_follows_by_its_share():
    target, online = torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)
    expected = 0.995 * target.weight + 0.005 * online.weight
    soft_update(target, online, 5e-3)
    torch.testing.assert_close(target.weight, expected)
