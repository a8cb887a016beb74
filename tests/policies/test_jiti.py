"""JITI as a LeRobot policy: it decides as `Guide` does, for each environment of its own."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.errors import UsageError  # noqa: E402
from jiti.policies import save_jiti  # noqa: E402
from jiti.runtime.candidates import open_sampler, open_scorer  # noqa: E402
from jiti.runtime.guidance import Guidance, Guide  # noqa: E402
from tests.runtime.candidates.conftest import TOLD, checkpoint, observation, tiny_critic, tiny_flow  # noqa: E402

# lerobot warns of its own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return checkpoint(tiny_flow(n_action_steps=4), tmp_path_factory.mktemp("base"))


@pytest.fixture(scope="module")
def critic(tmp_path_factory):
    return tiny_critic(tmp_path_factory.mktemp("critic") / "run")


def opened(folder, **changed):
    """As lerobot-eval opens it: its config with what the command line changes, then policy and pipelines."""
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    import jiti.policies

    jiti.policies.register()
    overrides = [f"--{name}={value}" for name, value in changed.items()]
    config = PreTrainedConfig.from_pretrained(folder, cli_overrides=overrides)
    policy = get_policy_class(config.type).from_pretrained(folder, config=config)
    steps = {"device_processor": {"device": "cpu"}, "rename_observations_processor": {"rename_map": {}}}
    return policy, *make_pre_post_processors(config, str(folder), preprocessor_overrides=steps)


def played(policy, before, after, seeds, steps=9):
    """Actions (steps, B, A) over observations that each environment has of its own."""
    actions = []
    policy.reset()
    for step in range(steps):
        seen = [observation(1000 * seed + step) for seed in seeds]
        batch = {key: torch.from_numpy(np.stack([one[key] for one in seen])) for key in seen[0]}
        with torch.inference_mode():
            actions.append(after(policy.select_action(before(batch | {"task": [TOLD] * len(seeds)}))))
    return torch.stack(actions).numpy()


def by_guide(base, critic, guidance, seed, of, steps=9):
    """The same by hand: a guide, and four actions of each chunk."""
    sampler, scorer = open_sampler(base), open_scorer(critic)
    guide, actions, decisions = Guide(guidance, seed, sampler.noise_shape), [], []
    for step in range(0, steps, 4):
        seen = sampler.observe(observation(1000 * of + step), TOLD)
        score = scorer.at(observation(1000 * of + step), TOLD, seen)
        chunk, decision = guide.decide(seen.sample, score)
        actions.extend(chunk[:4])
        decisions.append(decision)
    return np.stack(actions[:steps]), decisions


def test_every_environment_has_decisions_of_its_own(base, critic, tmp_path):
    policy, before, after = opened(save_jiti(tmp_path, base, critic, tau=0.1, seed=7))
    actions = played(policy, before, after, seeds=[3, 4])
    assert actions.shape == (9, 2, 7)
    for place, of in enumerate((3, 4)):
        wanted, decisions = by_guide(base, critic, Guidance(tau=0.1), 7 + place, of)
        assert np.allclose(actions[:, place], wanted, atol=1e-5)
        assert [d.chosen for d in policy.episodes[place].decisions] == [d.chosen for d in decisions]
    assert any(d.triggered for episode in policy.episodes for d in episode.decisions)


def test_a_new_episode_begins_anew_with_the_next_seed(base, critic, tmp_path):
    policy, before, after = opened(save_jiti(tmp_path, base, critic, method="full", seed=7))
    first = played(policy, before, after, seeds=[3, 4])
    second = played(policy, before, after, seeds=[3, 4])
    assert not np.allclose(first, second)
    for place, of in enumerate((3, 4)):
        wanted, _ = by_guide(base, critic, Guidance("full"), 9 + place, of)
        assert np.allclose(second[:, place], wanted, atol=1e-5)
    again = played(opened(tmp_path)[0], before, after, seeds=[3, 4])
    assert np.array_equal(first, again)


def test_one_candidate_is_the_base_policy_whatever_the_method(base, critic, tmp_path):
    save_jiti(tmp_path, base, critic, tau=0.0, candidates=1)
    found = [played(*opened(tmp_path, method=method), seeds=[3]) for method in ("none", "jiti", "full")]
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])


def test_the_command_line_changes_a_saved_policy(base, critic, tmp_path):
    save_jiti(tmp_path, base, critic, tau=0.1)
    policy, *_ = opened(tmp_path, method="full", candidates=3)
    assert (policy.guidance.method, policy.guidance.candidates) == ("full", 3)


def test_the_folder_refers_to_base_and_critic_and_may_be_anywhere(base, critic, tmp_path, monkeypatch):
    monkeypatch.chdir(base.parent)
    save_jiti(tmp_path / "jiti", base.name, critic, tau=0.1)
    assert sorted(path.name for path in (tmp_path / "jiti").glob("*")) == [
        "config.json",
        "policy_postprocessor.json",
        "policy_preprocessor.json",
    ]
    assert json.loads((tmp_path / "jiti/config.json").read_text())["base"] == str(base.resolve())
    monkeypatch.chdir(tmp_path)
    opened(tmp_path / "jiti")


def test_a_folder_may_hold_all_that_it_needs(base, critic, tmp_path):
    folder = save_jiti(tmp_path / "jiti", base, critic, tau=0.1)
    base.rename(folder / "base")
    try:
        config = json.loads((folder / "config.json").read_text())
        (folder / "config.json").write_text(json.dumps(config | {"base": "base"}))
        moved = folder.rename(tmp_path / "elsewhere")
        policy, *_ = opened(moved)
        assert policy.sampler.base.folder.is_relative_to(moved)
        # Saved again, it is found from anywhere.
        policy.save_pretrained(tmp_path / "again")
        assert json.loads((tmp_path / "again/config.json").read_text())["base"] == str((moved / "base").resolve())
        (moved / "base").rename(base)
    finally:
        assert base.exists()


def test_what_is_missing_or_makes_no_sense_is_refused_before_anything_is_written(base, critic, tmp_path):
    for settings, said in (
        ({"tau": None}, "tau is None"),
        ({"tau": 0.1, "method": "jitti"}, "did you mean 'jiti'"),
        ({"tau": 0.1, "candidates": 0}, "0 candidates"),
        ({"tau": 0.1, "seed": -1}, r"policy\.seed is -1; it must be 0 or more"),
        ({"tau": 0.1, "temperature": 2}, "temperature"),
    ):
        with pytest.raises(UsageError, match=said):
            save_jiti(tmp_path / "jiti", base, critic, **settings)
    with pytest.raises(UsageError, match=r"policy\.critic is empty, and method jiti asks one"):
        save_jiti(tmp_path / "jiti", base, tau=0.1)
    with pytest.raises(UsageError, match=r"policy\.base is empty"):
        save_jiti(tmp_path / "jiti", "", critic, tau=0.1)
    with pytest.raises(UsageError, match="chunks of 12 actions, and the policy gives 10"):
        save_jiti(tmp_path / "jiti", base, tiny_critic(tmp_path / "long", chunk=12), tau=0.1)
    assert not (tmp_path / "jiti").exists()


def test_without_guidance_no_critic_is_needed_and_nothing_is_ever_trained(base, tmp_path):
    policy, before, after = opened(save_jiti(tmp_path, base, method="none"))
    assert played(policy, before, after, seeds=[3, 4]).shape == (9, 2, 7)
    for train in (policy.get_optim_params, policy.config.get_optimizer_preset, lambda: policy.forward({})):
        with pytest.raises(UsageError, match="trains nothing"):
            train()


def test_a_policy_without_a_critic_is_saved_without_one_again(base, tmp_path):
    save_jiti(tmp_path / "first", base=base, method="none")
    policy, _, _ = opened(tmp_path / "first")
    policy.save_pretrained(tmp_path / "second")
    assert json.loads((tmp_path / "second/config.json").read_text())["critic"] == ""


def test_environments_cannot_come_and_go_within_an_episode(base, tmp_path):
    policy, before, after = opened(save_jiti(tmp_path, base, method="none"))
    played(policy, before, after, seeds=[3, 4])
    batch = {key: torch.from_numpy(value)[None] for key, value in observation().items()}
    with pytest.raises(UsageError, match="1 environments act, and 2 did before"):
        policy.select_action(before(batch | {"task": [TOLD]}))


def test_whole_chunks_are_given_as_well(base, critic, tmp_path):
    policy, before, _ = opened(save_jiti(tmp_path, base, critic, method="full", seed=7))
    batch = {key: torch.from_numpy(value)[None] for key, value in observation(3000).items()}
    policy.reset()
    chunk = policy.predict_action_chunk(before(batch | {"task": [TOLD]}))
    assert chunk.shape == (1, 10, 7)
    wanted, _ = by_guide(base, critic, Guidance("full"), 7, 3, steps=4)
    assert np.allclose(chunk[0, :4].numpy(), wanted, atol=1e-5)


def test_pictures_reach_the_base_policy_byte_for_byte():
    from lerobot.envs.utils import preprocess_observation

    from jiti.policies.modeling_jiti import _observations

    pictures = np.arange(2 * 16 * 16 * 3).reshape(2, 16, 16, 3).astype(np.uint8)
    batch = preprocess_observation({"pixels": {"front": pictures}, "agent_pos": np.zeros((2, 8))})
    observations, told = _observations({**batch, "task": [TOLD, "push"]})
    assert told == [TOLD, "push"]
    for row, observed in enumerate(observations):
        assert observed["observation.images.front"].dtype == np.uint8
        assert np.array_equal(observed["observation.images.front"], pictures[row])
