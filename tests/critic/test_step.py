"""The wiring of a step: which network values what, with which mask and noise, against a computation by hand."""

import numpy as np
import pytest
import torch  # noqa: TID253  these tests are about tensors

from jiti.critic.chunks import ActionRange
from jiti.critic.critic import Sizes, make_critic
from jiti.critic.settings_file import settings_from
from jiti.critic.step import Batch, State, critic_losses, draw_noise, init_state
from jiti.critic.team import Team

B, K, A, F, MEMBERS = 4, 3, 2, 5, 2


def begin(**loss):
    """A state whose target network is another than the online one, and a batch whose chunks are cut differently."""
    settings = settings_from(
        {
            "network": {"chunk": K, "width": 8, "heads": 2, "actor_width": 8, "ensemble": MEMBERS},
            "loss": {"policy_chunks": 2, "backup_chunks": 2, "random_chunks": 3, **loss},
            "run": {"batch": B},
        }
    )
    torch.manual_seed(0)
    critic = make_critic(settings.network, Sizes(F, 1, A), ActionRange(-np.ones(A), np.ones(A)), {})
    state = init_state(critic, settings, torch.device("cpu"))
    with torch.no_grad():
        for weight in state.target.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    batch = Batch(
        features=torch.randn(B, 1, F),
        next_features=torch.randn(B, 1, F),
        action=torch.rand(B, K, A) - 0.5,
        mask=torch.tensor([[1, 1, 1], [1, 1, 0], [1, 0, 0], [1, 1, 1]], dtype=torch.bool),
        next_mask=torch.tensor([[1, 0, 0], [1, 1, 0], [1, 0, 0], [1, 1, 1]], dtype=torch.bool),
        reward=torch.rand(B),
        discount=torch.tensor([0.8, 0.8, 0.0, 0.8]),
        mc_return=torch.tensor([5.0, -5.0, 0.0, 0.1]),
    )
    return settings, state, batch, draw_noise(settings, A, 0, Team("cpu"))


def one_by_one(network, features, chunks, mask):
    """Values (E, B, N), each chunk of each state by itself."""
    rows = [
        torch.cat([network(features[[b]], chunks[[b]][:, [n]], mask[[b]]) for n in range(chunks.shape[1])], 2)
        for b in range(len(chunks))
    ]
    return torch.cat(rows, 1)


def target_by_hand(state: State, batch: Batch, noise) -> torch.Tensor:
    ahead, _ = state.critic.actor.sample(batch.next_features, batch.next_mask, noise.backup)
    values = one_by_one(state.target, batch.next_features, ahead, batch.next_mask)
    least = torch.minimum(values[0], values[1])
    return batch.reward + batch.discount * (least[:, 0] + least[:, 1]) / 2


@torch.no_grad()
def test_the_papers_loss_is_what_a_hand_computes():
    settings, state, batch, noise = begin(alpha=2.0)
    total, conservative, _ = critic_losses(state, batch, noise, settings.loss)
    q = state.critic.q
    drawn, _ = state.critic.actor.sample(batch.features, batch.mask, noise.policy)
    q_data = one_by_one(q, batch.features, batch.action[:, None], batch.mask)[:, :, 0]
    q_policy = one_by_one(q, batch.features, drawn, batch.mask)
    y = target_by_hand(state, batch, noise)
    bellman, r_cal = 0.0, 0.0
    for member in range(MEMBERS):
        for b in range(B):
            bellman += float((q_data[member, b] - y[b]) ** 2) / B
            expected = float(q_policy[member, b].mean())
            r_cal += (max(expected, float(batch.mc_return[b])) - float(q_data[member, b])) / B
    assert conservative.item() == pytest.approx(r_cal, abs=1e-5)
    assert total.item() == pytest.approx(bellman + 2 * (r_cal - MEMBERS * 0.5), abs=1e-5)


@torch.no_grad()
def test_the_public_loss_is_what_a_hand_computes():
    settings, state, batch, noise = begin(variant="public", backup="max", lagrange=True, alpha=2.0, multiplier=0.7)
    total, conservative, _ = critic_losses(state, batch, noise, settings.loss)
    q, actor = state.critic.q, state.critic.actor
    drawn, log_p = actor.sample(batch.features, batch.mask, noise.policy)
    # Chunks of the policy at the next state are valued at this one, as long as chunks here are.
    following, log_p_following = actor.sample(batch.next_features, batch.mask, noise.following)
    q_data = one_by_one(q, batch.features, batch.action[:, None], batch.mask)[:, :, 0]
    q_drawn = one_by_one(q, batch.features, drawn, batch.mask)
    q_following = one_by_one(q, batch.features, following, batch.mask)
    q_random = one_by_one(q, batch.features, noise.random, batch.mask)
    log_uniform = -batch.mask.sum(1) * A * np.log(2)
    ahead, _ = actor.sample(batch.next_features, batch.next_mask, noise.backup)
    y = batch.reward + batch.discount * one_by_one(state.target, batch.next_features, ahead, batch.next_mask).amin(
        0
    ).amax(1)
    bellman, r_cal = 0.0, 0.0
    for member in range(MEMBERS):
        for b in range(B):
            bellman += float((q_data[member, b] - y[b]) ** 2) / B
            bound = float(batch.mc_return[b])
            terms = [max(float(v), bound) - float(p) for v, p in zip(q_drawn[member, b], log_p[b], strict=True)]
            terms += [
                max(float(v), bound) - float(p) for v, p in zip(q_following[member, b], log_p_following[b], strict=True)
            ]
            terms += [float(v) - float(log_uniform[b]) for v in q_random[member, b]]
            r_cal += (np.logaddexp.reduce(terms) - float(q_data[member, b])) / B
    assert conservative.item() == pytest.approx(r_cal, rel=1e-5)
    assert total.item() == pytest.approx(bellman + 2 * 0.7 * (r_cal - MEMBERS * 0.5), rel=1e-5)
