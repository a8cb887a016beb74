"""Components of an action with certain values only."""

import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")

from jiti.policies.levels import Levels  # noqa: E402


def statistics(data):
    return {
        "min": data.min(0).values,
        "max": data.max(0).values,
        "mean": data.mean(0),
        "std": data.std(0, correction=0),
    }


@pytest.fixture(scope="module")
def data():
    """A gripper of -1 and 1, mostly open; one that never moves; a wide number, and a fine one."""
    torch.manual_seed(0)
    gripper = torch.where(torch.rand(5000) < 0.3, 1.0, -1.0)
    return torch.stack([gripper, torch.full((5000,), 0.25), torch.randn(5000), 0.01 * torch.randn(5000)], dim=1)


def emitted(data, normalized):
    stats = statistics(data)
    levels = Levels(4)
    levels.learn(stats)
    return levels(normalized) * stats["std"] + stats["mean"]


def test_a_gripper_is_open_or_closed_and_what_never_moved_does_not(data):
    action = emitted(data, torch.randn(64, 10, 4))
    assert torch.allclose(action[..., 0].abs(), torch.ones(64, 10), atol=1e-5)
    assert {-1, 1} == set(action[..., 0].round().flatten().tolist())
    assert torch.equal(action[..., 1], torch.full((64, 10), 0.25))


def test_the_nearer_of_two_levels_is_taken(data):
    stats = statistics(data)
    wanted = torch.tensor([[-0.2, 0.25, 0, 0], [0.2, 0.25, 0, 0]])
    normalized = (wanted - stats["mean"]) / stats["std"].clamp_min(1e-8)
    assert emitted(data, normalized)[:, 0].tolist() == pytest.approx([-1, 1], abs=1e-5)


def test_numbers_between_stay_as_they_are(data):
    normalized = torch.randn(64, 10, 4)
    stats = statistics(data)
    action = emitted(data, normalized)
    assert torch.equal(action[..., 2:], (normalized * stats["std"] + stats["mean"])[..., 2:])


def test_three_levels_are_no_two():
    data = torch.tensor([-1.0, 0, 1]).repeat(100).unsqueeze(1)
    levels = Levels(1)
    levels.learn(statistics(data))
    assert levels(torch.tensor([[0.1]])).item() == pytest.approx(0.1)


def test_before_statistics_are_known_nothing_is_changed():
    x = torch.randn(3, 2)
    assert torch.equal(Levels(2)(x), x)
