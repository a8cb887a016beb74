"""A tiny policy and a tiny critic of one robot, with random weights, and torch on one thread."""

from pathlib import Path

import numpy as np
import pytest

STATE, SCENE = "observation.state", "observation.environment_state"
FRONT, WRIST = "observation.images.front", "observation.images.wrist"
TOLD = "put the bowl on the plate"


@pytest.fixture(autouse=True)
def one_thread():
    torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
    pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def inputs(*, state: int = 8, scene: int = 5, cameras: tuple[str, ...] = (), side: int = 32, action: int = 7) -> dict:
    """lerobot's words for what is observed and done."""
    from lerobot.configs.types import FeatureType, PolicyFeature

    seen = {STATE: PolicyFeature(FeatureType.STATE, (state,))}
    if scene:
        seen[SCENE] = PolicyFeature(FeatureType.ENV, (scene,))
    seen |= {camera: PolicyFeature(FeatureType.VISUAL, (3, side, side)) for camera in cameras}
    return {"input_features": seen, "output_features": {"action": PolicyFeature(FeatureType.ACTION, (action,))}}


def checkpoint(policy, run: Path) -> Path:
    """A run's folder with a policy in it, as `lerobot-train` leaves one; actions have other units than the policy."""
    import torch
    from lerobot.policies.factory import make_pre_post_processors

    folder = run / "checkpoints" / "last" / "pretrained_model"
    policy.save_pretrained(folder)
    stats = {}
    for key, feature in {**policy.config.input_features, **policy.config.output_features}.items():
        size = (3, 1, 1) if len(feature.shape) == 3 else feature.shape
        one = torch.ones(size)
        stats[key] = {"mean": 0.1 * one, "std": 2 * one, "min": -3 * one, "max": 3 * one}
        stats[key] |= {"q01": -2 * one, "q99": 2 * one}
    for part in make_pre_post_processors(policy.config, dataset_stats=stats):
        part.save_pretrained(folder)
    return run


def tiny_flow(**changed):
    """A `state_flow` policy whose weights are all random: at its start the velocity would be zero."""
    import torch

    from jiti.policies.configuration_state_flow import StateFlowConfig
    from jiti.policies.modeling_state_flow import StateFlowPolicy

    torch.manual_seed(1)
    options = {"device": "cpu", "width": 16, "depth": 1, "instructions": [TOLD, "push it away"]}
    policy = StateFlowPolicy(StateFlowConfig(**options | inputs() | changed))
    with torch.no_grad():
        for weight in policy.parameters():
            weight.normal_(0, 0.3)
    return policy


def tiny_critic(
    folder: Path,
    *,
    features: str = "state",
    fingerprint: str = "",
    tokens: int = 1,
    size: int = 13,
    chunk: int = 10,
    action: int = 7,
) -> Path:
    """A critic of one block, whose values spread."""
    import torch

    from jiti.critic.chunks import ActionRange
    from jiti.critic.critic import Sizes, make_critic, save_critic
    from jiti.critic.settings import NetworkSettings

    torch.manual_seed(2)
    network = NetworkSettings(width=16, depth=1, heads=2, chunk=chunk, actor_width=8)
    limits = ActionRange(np.full(action, -4, np.float32), np.full(action, 4, np.float32))
    critic = make_critic(network, Sizes(size, tokens, action), limits, {})
    with torch.no_grad():
        for weight in critic.q.parameters():
            weight.normal_(0, 0.4)
    save_critic(critic, folder, {"extractor": {"name": features, "fingerprint": fingerprint}})
    return folder


def observation(seed: int = 0, *, scene: int = 5, cameras: tuple[str, ...] = (), side: int = 32) -> dict:
    rng = np.random.default_rng(seed)
    seen = {STATE: rng.normal(size=8).astype(np.float32)}
    if scene:
        seen[SCENE] = rng.normal(size=scene).astype(np.float32)
    return seen | {camera: rng.integers(0, 256, (side, side, 3), np.uint8) for camera in cameras}


@pytest.fixture(scope="session")
def flow(tmp_path_factory) -> Path:
    pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")
    return checkpoint(tiny_flow(), tmp_path_factory.mktemp("flow"))


@pytest.fixture(scope="session")
def critic(tmp_path_factory) -> Path:
    pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
    return tiny_critic(tmp_path_factory.mktemp("critic") / "run")
