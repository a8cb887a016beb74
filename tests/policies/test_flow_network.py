"""The flow: its path, its loss, its integral."""

import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")

from jiti.policies.flow_network import (  # noqa: E402
    Block,
    FlowNetwork,
    flow_loss,
    follow,
    integrate,
    interpolate,
    ramped,
)


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def chunks(*shape: int):
    return torch.randn(5, 4, 3), torch.randn(5, 4, 3)


def test_the_path_begins_at_noise_and_ends_at_the_actions():
    actions, noise = chunks()
    assert torch.equal(interpolate(actions, noise, torch.zeros(5)), noise)
    assert torch.equal(interpolate(actions, noise, torch.ones(5)), actions)


def test_the_velocity_of_the_path_is_what_the_loss_asks_for():
    actions, noise = chunks()
    tau, step = torch.full((5,), 0.3, dtype=torch.float64), 1e-6
    a, n = actions.double(), noise.double()
    velocity = (interpolate(a, n, tau + step) - interpolate(a, n, tau)) / step
    assert flow_loss(velocity, a, n, torch.ones(5, 4)).max() < 1e-8
    assert flow_loss(velocity + 2, a, n, torch.ones(5, 4)).numpy() == pytest.approx(4.0)


def test_what_lies_behind_the_end_of_an_episode_does_not_count():
    actions, noise = chunks()
    velocity = torch.randn(5, 4, 3)
    valid = torch.tensor([[1.0, 1, 0, 0]] * 5)
    other = actions.clone()
    other[:, 2:] = 100
    assert torch.equal(flow_loss(velocity, actions, noise, valid), flow_loss(velocity, other, noise, valid))
    by_hand = (velocity - actions + noise).square()[:, :2].mean((1, 2))
    assert torch.allclose(flow_loss(velocity, actions, noise, valid), by_hand)
    assert flow_loss(velocity, actions, noise, torch.zeros(5, 4)).abs().max() == 0


@pytest.mark.parametrize("steps", [1, 8])
def test_euler_steps_along_a_straight_path_end_at_the_actions(steps):
    actions, noise = chunks()
    chunk = integrate(lambda _encoded, _chunk, _tau: actions - noise, torch.zeros(5, 2), noise, steps)
    assert torch.allclose(chunk, actions, atol=1e-6)


def test_a_block_changes_nothing_before_training():
    x = torch.randn(3, 8)
    assert torch.equal(Block(8)(x), x)


def test_each_sample_of_a_batch_is_on_its_own():
    network = FlowNetwork(6, 2, 4, 3, width=16, depth=2, frequencies=2)
    for weight in network.parameters():
        torch.nn.init.normal_(weight, std=0.2)
    observed, task, noise = torch.randn(5, 6), torch.eye(2)[[0, 1, 0, 1, 1]], torch.randn(5, 4, 3)
    tau = torch.rand(5)
    whole = network(network.encode(observed, task), noise, tau)
    for row in range(5):
        one = slice(row, row + 1)
        alone = network(network.encode(observed[one], task[one]), noise[one], tau[one])
        assert torch.allclose(whole[one], alone, atol=1e-6)


def test_the_average_moves_by_the_decay():
    network, average = torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)
    before = average.weight.detach().clone()
    follow(average, network, 0.9)
    assert torch.allclose(average.weight, 0.9 * before + 0.1 * network.weight)


def test_the_average_forgets_quickly_at_first():
    assert ramped(0.999, 0) == pytest.approx(0.1)
    assert ramped(0.999, 10**6) == 0.999
