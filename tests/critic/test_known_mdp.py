"""Cal-QL on a Markov decision process whose truth is known: a ring of states, chunks of two actions, left or right."""

from itertools import product

import numpy as np
import torch  # noqa: TID253  these tests are about tensors
from torch import nn  # noqa: TID253

from jiti.critic.cal_ql import bellman_loss, conservative_term, critic_loss, soft_update, td_target

STATES, GAMMA, OFFSET = 6, 0.9, 2
CHUNKS = list(product((-1, 1), repeat=OFFSET))
RIGHT = CHUNKS.index((1, 1))
REWARD = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.3])
"""Of stepping out of a state."""


def outcome(state: int, chunk: tuple[int, ...]) -> tuple[float, int]:
    """The discounted rewards of a chunk, and where it leads."""
    total = 0.0
    for step, action in enumerate(chunk):
        total += GAMMA**step * REWARD[state]
        state = (state + action) % STATES
    return total, state


OUTCOMES = [[outcome(state, chunk) for chunk in CHUNKS] for state in range(STATES)]
PAIRS = [(state, chunk) for state in range(STATES) for chunk in range(len(CHUNKS))]


def optimal() -> np.ndarray:
    """Q* (states, chunks), by dynamic programming."""
    q = np.zeros((STATES, len(CHUNKS)))
    for _ in range(500):
        q = np.array([[reward + GAMMA**OFFSET * q[follows].max() for reward, follows in row] for row in OUTCOMES])
    return q


def returns_going_right() -> np.ndarray:
    """V^mu (states,) of always going right."""
    v = np.zeros(STATES)
    for _ in range(500):
        v = np.array([OUTCOMES[s][RIGHT][0] + GAMMA**OFFSET * v[OUTCOMES[s][RIGHT][1]] for s in range(STATES)])
    return v


class Table(nn.Module):
    """Q of every state and chunk, of two members that begin apart."""

    def __init__(self, start: float) -> None:
        super().__init__()
        noise = torch.rand(2, STATES, len(CHUNKS), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        self.q = nn.Parameter(start + noise)


def learn(
    pairs: list[tuple[int, int]], *, alpha: float, start: float, calibrate: bool = True, steps: int = 500
) -> Table:
    """Q after full sweeps over pairs of state and chunk; the policy draws the chunks that are not in them."""
    online, target = Table(start), Table(start)
    optimizer = torch.optim.SGD(online.parameters(), lr=len(pairs) / 12)
    states, chunks = (torch.tensor(column) for column in zip(*pairs, strict=True))
    rewards, following = zip(*(OUTCOMES[s][c] for s, c in pairs), strict=True)
    reward, discount = torch.tensor(rewards, dtype=torch.float64), torch.full((len(pairs),), GAMMA**OFFSET).double()
    unseen = [[c for c in range(len(CHUNKS)) if (s, c) not in pairs] for s, _ in pairs]
    v_mu = torch.tensor(returns_going_right())[states]
    for _ in range(steps):
        backed_up = target.q[:, list(following)]
        if alpha:  # the policy is what the data does, as for a policy that learned from it
            backed_up = backed_up[:, :, [RIGHT]]
        q_data = online.q[:, states, chunks]
        loss = bellman_loss(q_data, td_target(reward, discount, backed_up, backup="max"))
        if alpha:
            q_policy = online.q[:, states[:, None], torch.tensor(unseen)]
            loss = critic_loss(loss, conservative_term(q_policy, q_data, v_mu, calibrate=calibrate)[0], alpha)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        soft_update(target, online, 0.2)
    return online


def test_without_the_conservative_term_q_is_that_of_dynamic_programming():
    learned = learn(PAIRS, alpha=0, start=3.0)
    np.testing.assert_allclose(learned.q.detach().numpy(), np.stack([optimal()] * 2), atol=1e-2)


def test_unseen_chunks_stay_under_the_datas_and_no_lower_than_the_return():
    seen = [(s, RIGHT) for s in range(STATES)]
    v_mu = torch.tensor(returns_going_right())
    unseen = [c for c in range(len(CHUNKS)) if c != RIGHT]
    bounded = learn(seen, alpha=1.0, start=8.0).q.detach()
    falling = learn(seen, alpha=1.0, start=8.0, calibrate=False).q.detach()
    assert (bounded[:, :, unseen].amax(-1) < bounded[:, :, RIGHT]).all()
    assert (bounded[:, :, unseen].mean(-1) > v_mu - 0.1).all()  # one step is up to 0.03
    assert (bounded[:, :, unseen].mean(-1) < v_mu + 0.1).all()
    assert (falling[:, :, unseen].mean(-1) < v_mu - 1).all()
