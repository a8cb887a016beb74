"""One step of training, and all that it changes."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch  # noqa: TID253  this module is imported late, by the command
from torch import Tensor, nn  # noqa: TID253

from jiti.critic.backbone import Backbone
from jiti.critic.cal_ql import (
    actor_loss,
    bellman_loss,
    clamped,
    conservative_term,
    conservative_term_public,
    critic_loss,
    multiplier_loss,
    soft_update,
    td_target,
    temperature_loss,
)
from jiti.critic.chunks import Chunks
from jiti.critic.critic import Critic
from jiti.critic.networks import QEnsemble
from jiti.critic.settings import LossSettings, Settings
from jiti.critic.team import Team


@dataclass
class Batch:
    """A process's share of a step, as tensors on its device; names and shapes as in `Chunks`."""

    features: Tensor
    next_features: Tensor
    action: Tensor
    mask: Tensor
    next_mask: Tensor
    reward: Tensor
    discount: Tensor
    mc_return: Tensor


@dataclass
class State:
    """All that a step changes."""

    critic: Critic
    target: QEnsemble
    log_temperature: nn.Parameter
    log_multiplier: nn.Parameter
    optimizers: dict[str, torch.optim.Optimizer]
    step: int = 0
    best: dict[str, float] = field(default_factory=dict)
    """What validation said of the best step, and its number as `step`."""
    looks_without_better: int = 0


@dataclass(frozen=True)
class Noise:
    """Random numbers of one step for the whole batch, of which a process takes its share."""

    policy: Tensor
    backup: Tensor
    actor: Tensor
    following: Tensor
    random: Tensor


def init_state(critic: Critic, settings: Settings, device: torch.device) -> State:
    """A state before the first step. Q, actor and target go to the device."""
    critic.q.to(device)
    critic.actor.to(device)
    target = copy.deepcopy(critic.q).requires_grad_(False)
    rates, loss = settings.optimizer, settings.loss
    log_temperature = nn.Parameter(torch.tensor(float(np.log(max(loss.temperature, 1e-12))), device=device))
    log_multiplier = nn.Parameter(torch.tensor(float(np.log(max(loss.multiplier, 1e-12))), device=device))
    slow = list(critic.q.trunk.parameters()) if isinstance(critic.q.trunk, Backbone) else []
    names = {id(p) for p in slow}
    groups = [{"params": [p for p in critic.q.parameters() if id(p) not in names], "lr": rates.critic_lr}]
    if slow:
        groups.append({"params": [p for p in slow if p.requires_grad], "lr": rates.backbone_lr})
    optimizers: dict[str, torch.optim.Optimizer] = {
        "critic": torch.optim.Adam(groups),
        "actor": torch.optim.Adam(critic.actor.parameters(), lr=rates.actor_lr),
        "temperature": torch.optim.Adam([log_temperature], lr=rates.temperature_lr),
        "multiplier": torch.optim.Adam([log_multiplier], lr=rates.multiplier_lr),
    }
    return State(critic, target, log_temperature, log_multiplier, optimizers)


def fit_to_data(critic: Critic, features: Tensor, mc_return: np.ndarray) -> None:
    """Normalization of features (n, T, F), and the scale of values, from the training split."""
    critic.q.normalize.fit(features)
    critic.actor.normalize.fit(features)
    scale = float(np.sqrt(np.mean(np.square(mc_return))))
    critic.q.scale.fill_(scale if scale > 0 else 1.0)


def to_batch(chunks: Chunks, features: Tensor, next_features: Tensor, device: torch.device) -> Batch:
    """Chunks and the features of their frames as tensors on the device."""

    def tensor(values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).to(device)

    return Batch(
        features=features.to(device),
        next_features=next_features.to(device),
        action=tensor(chunks.action),
        mask=tensor(chunks.mask),
        next_mask=tensor(chunks.next_mask),
        reward=tensor(chunks.reward),
        discount=tensor(chunks.discount),
        mc_return=tensor(chunks.mc_return),
    )


def draw_noise(settings: Settings, action: int, step: int, team: Team) -> Noise:
    """Noise of a step: the same for every number of processes."""
    loss, k, batch = settings.loss, settings.network.chunk, settings.run.batch
    generator = torch.Generator().manual_seed((settings.run.seed << 32) + step)

    def draw(chunks: int, kind: Callable[..., Tensor]) -> Tensor:
        return team.share(kind((batch, chunks, k, action), generator=generator)).to(team.device)

    public = loss.variant == "public" and loss.alpha > 0
    return Noise(
        policy=draw(loss.policy_chunks, torch.randn),
        backup=draw(loss.backup_chunks, torch.randn),
        actor=draw(1, torch.randn),
        following=draw(loss.policy_chunks if public else 0, torch.randn),
        random=draw(loss.random_chunks if public else 0, torch.rand) * 2 - 1,
    )


def critic_losses(
    state: State, batch: Batch, noise: Noise, loss: LossSettings
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """Q's loss, the conservative term without its weight, and metrics."""
    critic, target = state.critic, state.target
    with torch.no_grad():
        ahead, _ = critic.actor.sample(batch.next_features, batch.next_mask, noise.backup)
        next_q = target(batch.next_features, ahead, batch.next_mask)
        y = td_target(batch.reward, batch.discount, next_q, backup=loss.backup)
        chunks, log_density = critic.actor.sample(batch.features, batch.mask, noise.policy)
        following, following_density = critic.actor.sample(batch.next_features, batch.mask, noise.following)
    pushed_down = [chunks, following, noise.random] if loss.alpha > 0 or loss.lagrange else []
    values = critic.q(batch.features, torch.cat([batch.action.unsqueeze(1), *pushed_down], 1), batch.mask)
    q_data = values[:, :, 0]
    bellman = bellman_loss(q_data, y)
    conservative, active = q_data.new_zeros(()), q_data.new_zeros(())
    if pushed_down:
        n, m = chunks.shape[1] + following.shape[1], noise.random.shape[1]
        q_policy, q_random = values[:, :, 1 : 1 + n], values[:, :, 1 + n :]
        if loss.variant == "paper":
            conservative, active = conservative_term(q_policy, q_data, batch.mc_return, calibrate=loss.calibrate)
        else:
            volume = -float(np.log(2)) * batch.mask.sum(1, keepdim=True) * batch.action.shape[-1]
            conservative, active = conservative_term_public(
                q_policy,
                q_random,
                q_data,
                batch.mc_return,
                torch.cat([log_density, following_density], 1),
                volume.expand(-1, m),
                calibrate=loss.calibrate,
            )
    weight = loss.alpha * clamped(state.log_multiplier) if loss.lagrange else loss.alpha
    total = critic_loss(bellman, conservative, weight, gap=loss.action_gap, members=len(q_data))
    metrics = {
        "loss/critic": total,
        "loss/bellman": bellman,
        "loss/conservative": conservative,
        "q/data": q_data.mean(),
        "q/policy": values[:, :, 1 : 1 + chunks.shape[1]].mean() if pushed_down else q_data.new_zeros(()),
        "q/target": y.mean(),
        "q/mc_return": batch.mc_return.mean(),
        "q/spread": (q_data.amax(0) - q_data.amin(0)).mean(),
        "bound/active": active,
    }
    return total, conservative, metrics


def train_step(state: State, batch: Batch, noise: Noise, settings: Settings, team: Team) -> dict[str, Tensor]:
    """One step of Q, of the actor, of its temperature, of the multiplier and of the target network. Changes `state`."""
    critic, loss, clip = state.critic, settings.loss, settings.optimizer.clip
    with team.precision(settings.run.precision):
        total, conservative, metrics = critic_losses(state, batch, noise, loss)
    metrics["norm/critic"] = _descend(state.optimizers["critic"], total, team, clip)

    learned = [parameter for parameter in critic.q.parameters() if parameter.requires_grad]
    for parameter in learned:
        parameter.requires_grad_(False)
    with team.precision(settings.run.precision):
        chunks, log_density = critic.actor.sample(batch.features, batch.mask, noise.actor)
        q_policy = critic.q(batch.features, chunks, batch.mask)
    temperature = state.log_temperature.exp()
    actor = actor_loss(log_density, q_policy, temperature)
    metrics["norm/actor"] = _descend(state.optimizers["actor"], actor, team, clip)
    for parameter in learned:
        parameter.requires_grad_(True)

    numbers = settings.network.chunk * batch.action.shape[-1]
    entropy = -float(numbers) if loss.target_entropy is None else loss.target_entropy
    _descend(state.optimizers["temperature"], temperature_loss(state.log_temperature, log_density, entropy), team, None)
    if loss.lagrange:
        members = settings.network.ensemble
        followed = multiplier_loss(state.log_multiplier, conservative, loss.alpha, loss.action_gap, members=members)
        _descend(state.optimizers["multiplier"], followed, team, None)
        metrics["multiplier"] = clamped(state.log_multiplier)
    soft_update(state.target, critic.q, loss.soft_update)
    state.step += 1
    metrics |= {"loss/actor": actor, "actor/entropy": -log_density.mean(), "actor/temperature": temperature}
    return {name: value.detach() for name, value in metrics.items()}


@torch.no_grad()
def bellman_error(state: State, batch: Batch, loss: LossSettings) -> float:
    """L_Bellman of a batch, with the actor's median chunk at the next state: without noise, so that looks compare."""
    ahead = torch.tanh(state.critic.actor(batch.next_features)[0]).unsqueeze(1)
    y = td_target(batch.reward, batch.discount, state.target(batch.next_features, ahead, batch.next_mask))
    q = state.critic.q(batch.features, batch.action.unsqueeze(1), batch.mask)[:, :, 0]
    return float(bellman_loss(q, y))


def _descend(optimizer: torch.optim.Optimizer, loss: Tensor, team: Team, clip: float | None) -> Tensor:
    """One step down a loss, with gradients averaged over processes; the norm before it was clipped."""
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    team.average_gradients(parameters)
    norm = nn.utils.clip_grad_norm_(parameters, clip) if clip else loss.new_zeros(())
    optimizer.step()
    return norm
