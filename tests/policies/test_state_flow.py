"""The flow-matching policy from state, as lerobot uses it."""

import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from types import SimpleNamespace  # noqa: E402

from jiti.errors import UsageError  # noqa: E402

# lerobot warns of its own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")

LEFT, RIGHT = "go left", "go right"
STATE, SCENE, ACTION = "observation.state", "observation.environment_state", "action"


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def configuration(**changed):
    from lerobot.configs.types import FeatureType, PolicyFeature

    from jiti.policies.configuration_state_flow import StateFlowConfig

    seen = {STATE: PolicyFeature(FeatureType.STATE, (2,)), SCENE: PolicyFeature(FeatureType.ENV, (3,))}
    options = {
        "device": "cpu",
        "chunk_size": 4,
        "n_action_steps": 3,
        "width": 32,
        "depth": 1,
        "frequencies": 1,
        "ema_decay": 0.9,
        "input_features": seen,
        "output_features": {ACTION: PolicyFeature(FeatureType.ACTION, (2,))},
    }
    return StateFlowConfig(**options | changed)


def build(**changed):
    from jiti.policies.modeling_state_flow import StateFlowPolicy

    tasks = SimpleNamespace(tasks=SimpleNamespace(index=[LEFT, RIGHT]))
    stats = {
        ACTION: {"min": [-1.0, -3.0], "max": [1.0, 3.0], "mean": [0.0, 0.0], "std": [1.0, 1.0]},
    }
    return StateFlowPolicy(configuration(**changed), dataset_stats=stats, dataset_meta=tasks)


def observations(rows: int, task=LEFT):
    said = task if isinstance(task, list) else [task] * rows
    return {STATE: torch.randn(rows, 2), SCENE: torch.randn(rows, 3), "task": said}


def lesson(rows: int = 64):
    """The instruction says where to go; the first number is -1 or 1, by chance."""
    batch = observations(rows, [LEFT if torch.rand(()) < 0.5 else RIGHT for _ in range(rows)])
    way = torch.tensor([-2.0 if task == LEFT else 2.0 for task in batch["task"]])
    coin = torch.where(torch.rand(rows) < 0.5, -1.0, 1.0)
    batch[ACTION] = torch.stack([coin, way], dim=1).unsqueeze(1).expand(rows, 4, 2)
    return batch


@pytest.fixture(scope="module")
def taught():
    torch.manual_seed(0)
    torch.set_num_threads(1)
    policy = build(draws=2)
    policy.train()
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(400):
        loss, _ = policy.forward(lesson())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
    return policy.eval()


def test_it_goes_where_the_instruction_says_and_draws_both_of_two_ways(taught):
    for task, way in ((LEFT, -2.0), (RIGHT, 2.0)):
        chunks = taught.predict_action_chunk(observations(128, task))
        assert chunks.shape == (128, 4, 2)
        assert chunks[..., 1].mean().item() == pytest.approx(way, abs=0.2)
        assert set(chunks[..., 0].flatten().tolist()) == {-1, 1}
        assert 0.25 < (chunks[:, 0, 0] > 0).float().mean() < 0.75


def test_a_saved_policy_does_the_same(taught, tmp_path):
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class

    taught.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    assert config.instructions == [LEFT, RIGHT]
    again = get_policy_class(config.type).from_pretrained(tmp_path, config=config)
    seen, noise = observations(5, [LEFT, RIGHT, LEFT, RIGHT, "something else"]), torch.randn(5, 4, 2)
    assert torch.equal(again.predict_action_chunk(seen, noise), taught.predict_action_chunk(seen, noise))


def test_an_instruction_that_training_did_not_have_is_no_instruction(taught):
    seen, noise = observations(3), torch.randn(3, 4, 2)
    unknown = taught.predict_action_chunk(seen | {"task": ["juggle"] * 3}, noise)
    none = taught.predict_action_chunk({k: v for k, v in seen.items() if k != "task"}, noise)
    assert torch.equal(unknown, none)
    assert torch.isfinite(unknown).all()
    assert not torch.equal(unknown, taught.predict_action_chunk(seen, noise))


def test_space_around_an_instruction_is_of_no_matter_in_the_dataset_and_in_a_rollout():
    policy = build(instructions=["go left ", RIGHT])
    told = policy._tasks(["go left ", "go left", " go right\n"], torch.zeros(3, 1))
    assert told.tolist() == [[1, 0], [1, 0], [0, 1]]
    twice = build(instructions=["go left ", "go left"])
    assert twice._tasks(["go left"], torch.zeros(1, 1)).tolist() == [[0, 1]]


def test_candidates_are_what_each_noise_gives_alone(taught):
    seen, noise = observations(3, [LEFT, RIGHT, LEFT]), torch.randn(3, 8, 4, 2)
    candidates = taught.predict_action_chunk(seen, noise)
    assert candidates.shape == (3, 8, 4, 2)
    for which in range(8):
        alone = taught.predict_action_chunk(seen, noise[:, which])
        assert torch.allclose(candidates[:, which], alone, atol=1e-5)


def test_actions_of_a_chunk_come_in_order_and_a_new_episode_begins_anew(taught):
    seen, noise = observations(2), torch.randn(2, 4, 2)
    chunk = taught.predict_action_chunk(seen, noise)
    taught.reset()
    for step in range(3):
        assert torch.equal(taught.select_action(seen, noise), chunk[:, step])
    other = torch.randn(2, 4, 2)
    assert torch.equal(taught.select_action(seen, other), taught.predict_action_chunk(seen, other)[:, 0])
    taught.reset()
    assert torch.equal(taught.select_action(seen, noise), chunk[:, 0])


def test_losses_of_samples_average_to_the_loss_so_that_they_can_be_weighted(taught):
    batch = lesson(16)
    torch.manual_seed(5)
    each, _ = taught.forward(batch, reduction="none")
    torch.manual_seed(5)
    loss, told = taught.forward(batch)
    assert each.shape == (16,)
    assert each.mean().item() == pytest.approx(loss.item()) == pytest.approx(told["flow_loss"])


def test_padding_has_no_say():
    batch = lesson(16)
    batch["action_is_pad"] = torch.tensor([[False, False, True, True]] * 16)
    spoiled = batch | {ACTION: torch.cat([batch[ACTION][:, :2], torch.full((16, 2, 2), 50.0)], 1)}
    # Before any training its velocity is the same for all chunks, so that only what is asked for can differ.
    policy = build().train()
    losses = []
    for given in (batch, spoiled):
        torch.manual_seed(3)
        losses.append(policy.forward(given)[0].item())
    assert losses[0] == losses[1]


def test_the_average_acts_and_the_network_learns():
    policy = build()
    seen, noise = observations(2), torch.randn(2, 4, 2)
    before = policy.predict_action_chunk(seen, noise)
    with torch.no_grad():
        for weight in policy.network.parameters():
            weight.add_(0.5)
    assert torch.equal(policy.predict_action_chunk(seen, noise), before)
    policy.update()
    assert not torch.equal(policy.predict_action_chunk(seen, noise), before)
    assert {id(p) for p in policy.get_optim_params()} == {id(p) for p in policy.network.parameters()}


def test_what_hardly_varied_in_training_cannot_carry_it_away(taught):
    seen, noise = observations(2), torch.randn(2, 4, 2)
    far, farther = (taught.predict_action_chunk(seen | {SCENE: torch.full((2, 3), x)}, noise) for x in (9.0, 1e6))
    assert torch.equal(far, farther)


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"n_action_steps": 9}, "n_action_steps is 9"), ({"ema_decay": 1.0}, "ema_decay"), ({"draws": 0}, "draws is 0")],
)
def test_settings_that_make_no_sense_are_refused(changed, said):
    with pytest.raises(UsageError, match=said):
        configuration(**changed)


def test_a_dataset_with_pictures_alone_is_refused_with_a_policy_for_them():
    from lerobot.configs.types import FeatureType, PolicyFeature

    with pytest.raises(UsageError, match=r"observation.images.front.*smolvla"):
        build(input_features={"observation.images.front": PolicyFeature(FeatureType.VISUAL, (3, 8, 8))})


def test_observations_and_noise_of_other_sizes_are_refused(taught):
    with pytest.raises(UsageError, match=r"observation.state must have 2 numbers.*\(1, 5\)"):
        taught.predict_action_chunk({STATE: torch.zeros(1, 5), SCENE: torch.zeros(1, 3)})
    with pytest.raises(UsageError, match="environment_state must have 3 numbers"):
        taught.predict_action_chunk({STATE: torch.zeros(1, 2)})
    with pytest.raises(UsageError, match="noise has the shape"):
        taught.predict_action_chunk(observations(2), torch.zeros(2, 5, 2))
