"""Cal-QL over chunks of actions: the losses, as pure functions of tensors.

    L(Q) = L_Bellman + alpha * R_cal                                                         main paper
    L_Bellman = E[ (Q(s_t, A_t) - y_t)^2 ],  y_t = sum_{i<n} gamma^i r_{t+i} + gamma^n Q'(s_{t+n}, A'),  A' ~ pi
    R_cal = E_s[ max(E_{A~pi} Q(s, A), V^mu(s)) - E_{A~D} Q(s, A) ]                          main paper

E members of an ensemble are an axis, and losses are summed over it: each member learns as if it were alone. With
V^mu(s_t) the Monte-Carlo return of the demonstration, the term pushes Q of the policy's chunks down no further than
what the demonstrators reached from there; without the maximum it is CQL's.

Two published ways to write the term are here, as a switch (`Variant`):

`paper`   as above: policy chunks at s only, their mean compared with V^mu once a state.
`public`  as the code published with Cal-QL (Nakamoto et al. 2023) does: chunks of the policy at s, of the policy at
          s_{t+n}, and uniformly random ones, all valued at s; each of the policy's is compared with V^mu, random ones
          are not; log-sum-exp instead of the mean, each value less its log density. With chunks of K * A numbers these
          densities are large (a uniform chunk of 10 x 7 has log density -48.5), so that weights outdo values.
"""

from typing import Literal

import torch  # noqa: TID253  this module is imported by training and evaluation only, which need torch
from torch import Tensor  # noqa: TID253
from torch.nn.functional import mse_loss  # noqa: TID253

Variant = Literal["paper", "public"]
MULTIPLIER_LIMIT = 1e6
"""Greatest Lagrange multiplier. As in the code published with Cal-QL."""


def td_target(reward: Tensor, discount: Tensor, next_q: Tensor, *, backup: Literal["mean", "max"] = "mean") -> Tensor:
    """y (B,) of n-step rewards (B,), gamma^n or 0 (B,), and target values (E, B, N) of N policy chunks at s_{t+n}.

    y = reward + discount * mean_N min_E next_q; `max` takes the best of the N chunks, as the code published with Cal-QL
    does. The minimum over members counters overestimation (clipped double Q). No entropy is added. No gradient.
    """
    least = next_q.amin(0)
    value = least.mean(-1) if backup == "mean" else least.amax(-1)
    return (reward + discount * value).detach()


def bellman_loss(q: Tensor, target: Tensor) -> Tensor:
    """sum_E mean_B (q - y)^2, of values (E, B) of the data's chunks and targets (B,). Gradients reach `q` only."""
    return mse_loss(q, target.detach().expand_as(q), reduction="none").mean(1).sum()


def calibrated(q_policy: Tensor, v_mu: Tensor) -> tuple[Tensor, Tensor]:
    """max(q, V^mu) and the share of values where the bound is active, of values (E, B, ...) and V^mu (B,).

    Where Q of the policy is under V^mu there is no gradient: it is pushed down no further. No gradient reaches V^mu.
    """
    bound = v_mu.detach().reshape(1, -1, *(1,) * (q_policy.dim() - 2)).expand_as(q_policy)
    active = (q_policy < bound).float().mean()
    return torch.maximum(q_policy, bound), active.detach()


def conservative_term(
    q_policy: Tensor, q_data: Tensor, v_mu: Tensor, *, calibrate: bool = True
) -> tuple[Tensor, Tensor]:
    """R_cal of the paper, and the share of states where the bound is active.

    sum_E mean_B [ max(mean_N q_policy, V^mu) - q_data ], of values (E, B, N) of policy chunks, (E, B) of the data's
    chunks and V^mu (B,). Gradients reach both values. Without `calibrate` it is CQL's term for actions of the policy.
    """
    expected = q_policy.mean(-1)
    bounded, active = calibrated(expected, v_mu)
    pushed_down = bounded if calibrate else expected
    return (pushed_down - q_data).mean(1).sum(), active


def conservative_term_public(
    q_policy: Tensor,
    q_random: Tensor,
    q_data: Tensor,
    v_mu: Tensor,
    log_density_policy: Tensor,
    log_density_random: Tensor,
    *,
    calibrate: bool = True,
) -> tuple[Tensor, Tensor]:
    """R_cal as in the code published with Cal-QL, and the share of policy values where the bound is active.

    sum_E mean_B [ log sum_j exp(q_j - log p_j) - q_data ], where j runs over policy chunks, (E, B, N) with log
    densities (B, N), each value bounded below by V^mu (B,), and over random chunks, (E, B, M) with (B, M), which are
    not bounded. No gradient reaches the densities.
    """
    bounded, active = calibrated(q_policy, v_mu)
    values = torch.cat(
        [
            (bounded if calibrate else q_policy) - log_density_policy.detach(),
            q_random - log_density_random.detach(),
        ],
        dim=-1,
    )
    return (torch.logsumexp(values, -1) - q_data).mean(1).sum(), active


def critic_loss(
    bellman: Tensor, conservative: Tensor, alpha: float | Tensor, *, gap: float = 0.0, members: int = 1
) -> Tensor:
    """L = L_Bellman + alpha * sum_E (R_cal - gap), of terms that are sums over the members already.

    With a fixed alpha (5.0, supplement C.4) the gap has no effect. With Lagrange's multiplier, alpha is weight *
    multiplier; no gradient reaches it from here.
    """
    weight = alpha.detach() if isinstance(alpha, Tensor) else alpha
    return bellman + weight * (conservative - members * gap)


def clamped(log_multiplier: Tensor) -> Tensor:
    """Lagrange's multiplier, one for all members, as it weights the conservative term and as it is learned."""
    return log_multiplier.exp().clamp(max=MULTIPLIER_LIMIT)


def multiplier_loss(
    log_multiplier: Tensor, conservative: Tensor, weight: float, gap: float, *, members: int = 1
) -> Tensor:
    """-multiplier * weight * mean_E (R_cal - gap): the multiplier grows while a member's R_cal is above the gap.

    The term is the members' sum. The gap is 0.5 in supplement C.4, which leaves this unused; it is subtracted for each
    member, as in the code published with Cal-QL. Gradients reach the multiplier only.
    """
    return -clamped(log_multiplier) * weight * (conservative.detach() / members - gap)


def actor_loss(log_density: Tensor, q_policy: Tensor, temperature: Tensor) -> Tensor:
    """E[ temperature * log pi(A|s) - min_E Q(s, A) ], A ~ pi, of log densities (B, N) and values (E, B, N).

    Gradients reach the actor through both; the caller holds the critic's parameters fixed. None reaches the
    temperature.
    """
    return (temperature.detach() * log_density - q_policy.amin(0)).mean()


def temperature_loss(log_temperature: Tensor, log_density: Tensor, target_entropy: float) -> Tensor:
    """-log temperature * E[ log pi + target entropy ]: it grows while the policy's entropy is under its target.

    Gradients reach the temperature only. Its target is minus the number of dimensions, as in SAC.
    """
    return -log_temperature * (log_density.detach() + target_entropy).mean()


@torch.no_grad()
def soft_update(target: torch.nn.Module, online: torch.nn.Module, rate: float) -> None:
    """target <- (1 - rate) * target + rate * online; rate 5e-3 in supplement C.4. Buffers are copied."""
    for kept, new in zip(target.parameters(), online.parameters(), strict=True):
        kept.lerp_(new, rate)
    for kept, new in zip(target.buffers(), online.buffers(), strict=True):
        kept.copy_(new)
