"""Features of GR00T and of any policy of lerobot: the same for a frame in any batch."""

import json
import shutil
from types import SimpleNamespace

import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.critic.features import open_extractor  # noqa: E402
from jiti.critic.features.groot import GrootFeatures  # noqa: E402
from jiti.critic.features.opened_policy import OpenedPolicy  # noqa: E402
from jiti.critic.features.policy import MODULES  # noqa: E402
from jiti.errors import UsageError  # noqa: E402
from tests.critic.same_features import same_in_any_batch  # noqa: E402

# lerobot and transformers warn of their own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")

STATE, SCENE = "observation.state", "observation.environment_state"
FRONT = "observation.images.front"
SHAPES = {STATE: (8,), SCENE: (5,), "action": (7,)}


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def checkpoint(policy, run):
    """A run's folder with a policy in it, as `lerobot-train` leaves one."""
    from lerobot.policies.factory import make_pre_post_processors

    folder = run / "checkpoints" / "last" / "pretrained_model"
    policy.save_pretrained(folder)
    features = {**policy.config.input_features, **policy.config.output_features}
    stats = {key: {"mean": torch.zeros(f.shape[0]), "std": torch.ones(f.shape[0])} for key, f in features.items()}
    stats |= {FRONT: {"mean": torch.zeros(3, 1, 1), "std": torch.ones(3, 1, 1)}}
    for part in make_pre_post_processors(policy.config, dataset_stats=stats):
        part.save_pretrained(folder)
    return run


def inputs():
    """lerobot's words for `SHAPES`."""
    from lerobot.configs.types import FeatureType, PolicyFeature

    return {
        "input_features": {STATE: PolicyFeature(FeatureType.STATE, (8,)), SCENE: PolicyFeature(FeatureType.ENV, (5,))},
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (7,))},
    }


def state_flow():
    from jiti.policies.configuration_state_flow import StateFlowConfig
    from jiti.policies.modeling_state_flow import StateFlowPolicy

    told = ["put it there", "push it away"]
    return StateFlowPolicy(StateFlowConfig(device="cpu", width=16, depth=1, instructions=told, **inputs()))


def act():
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy

    seen = inputs()
    seen["input_features"][FRONT] = PolicyFeature(FeatureType.VISUAL, (3, 64, 64))
    small = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "n_encoder_layers": 1, "n_vae_encoder_layers": 1}
    return ACTPolicy(
        ACTConfig(device="cpu", chunk_size=5, n_action_steps=5, pretrained_backbone_weights=None, **small, **seen)
    )


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    return checkpoint(state_flow(), tmp_path_factory.mktemp("run"))


@pytest.mark.parametrize("kind", MODULES)
def test_every_policy_with_a_module_of_its_own_gives_features(kind, tmp_path):
    run = checkpoint({"state_flow": state_flow, "act": act}[kind](), tmp_path)
    extractor = open_extractor(f"policy:{run}", SHAPES | {FRONT: (64, 64, 3)})
    whole = same_in_any_batch(extractor, observations() | {FRONT: torch.rand(3, 3, 64, 64)})
    # ACT: a latent that is 0 without its encoder, both states, and 2 x 2 places of the picture.
    assert whole.shape == (3, {"state_flow": 1, "act": 7}[kind], 16)
    assert not torch.allclose(whole[0], whole[1])


def observations(frames=3):
    said = ["put it there", "push it away", "juggle"][:frames]
    return {STATE: torch.randn(frames, 8), SCENE: torch.randn(frames, 5), "task": said}


def test_any_policy_gives_what_a_module_of_it_gives(flow):
    extractor = open_extractor(f"policy:{flow}", SHAPES)
    assert (extractor.tokens, extractor.size) == (1, 16)
    assert extractor.needs == (STATE, SCENE, "task")
    whole = same_in_any_batch(extractor, observations())
    assert not torch.allclose(whole[0], whole[1])
    network = extractor._policy.average
    batch = observations()
    task = torch.tensor([[1.0, 0], [0, 1], [0, 0]])
    by_hand = network.encode(torch.cat([batch[STATE], batch[SCENE]], 1), task)
    assert torch.allclose(extractor.features(batch)[:, 0], by_hand, atol=1e-4)


def test_the_fingerprint_tells_policies_and_modules_apart(flow, tmp_path):
    one = open_extractor(f"policy:{flow}", SHAPES)
    copied = shutil.copytree(flow / "checkpoints/last/pretrained_model", tmp_path / "copy")
    assert open_extractor(f"policy:{copied}", SHAPES).fingerprint == one.fingerprint
    assert open_extractor(f"policy:{flow}#average.encoder.first", SHAPES).fingerprint != one.fingerprint
    weights = copied / "model.safetensors"
    changed = bytearray(weights.read_bytes())
    changed[-3] ^= 1
    weights.write_bytes(changed)
    assert open_extractor(f"policy:{copied}", SHAPES).fingerprint != one.fingerprint


@pytest.mark.parametrize(
    ("argument", "shapes", "said"),
    [
        ("#no.such.part", SHAPES, r"no module no\.such\.part.*average"),
        ("#network", SHAPES, "without calling that module"),
        ("", SHAPES | {STATE: (6,)}, "8 numbers, and here it has 6"),
        ("", {STATE: (8,), "action": (7,)}, "environment_state"),
    ],
)
def test_what_does_not_fit_is_refused(flow, argument, shapes, said):
    with pytest.raises(UsageError, match=said):
        open_extractor(f"policy:{flow}{argument}", shapes)


def test_what_is_no_policy_or_another_kind_is_refused(flow, tmp_path, monkeypatch):
    with pytest.raises(UsageError, match=r"config\.json"):
        open_extractor(f"policy:{tmp_path}", SHAPES)
    with pytest.raises(UsageError, match="type state_flow, not smolvla"):
        open_extractor(f"smolvla:{flow}", SHAPES)
    with pytest.raises(UsageError, match="there is no such folder"):
        open_extractor("policy:not a name", SHAPES)
    (tmp_path / "config.json").write_text(json.dumps({"type": "gpt"}))
    with pytest.raises(UsageError, match="gpt"):
        open_extractor(f"policy:{tmp_path}", SHAPES)
    with pytest.raises(UsageError, match=r"lacks observation\.environment_state"):
        open_extractor(f"policy:{flow}", SHAPES).features({STATE: torch.zeros(1, 8), "task": [""]})


class StandInGroot(torch.nn.Module):
    """GR00T's two parts, by its names and with its outputs; the real one needs 3B weights and diffusers."""

    def __init__(self):
        super().__init__()
        self._groot_model = torch.nn.Module()
        self._groot_model.config = SimpleNamespace(backbone_embedding_dim=6, input_embedding_dim=4)
        self._groot_model.backbone = StandInBackbone()
        self._groot_model.action_head = torch.nn.Module()
        self._groot_model.action_head.state_encoder = torch.nn.Linear(8, 4)

    def reset(self):
        pass

    def select_action(self, batch):
        self._groot_model.backbone(batch)
        self._groot_model.action_head.state_encoder(batch[STATE].unsqueeze(1))
        raise AssertionError("the policy must not be run to its end")


class StandInBackbone(torch.nn.Module):
    def forward(self, batch):
        hidden = batch[STATE][:, None, :6] * torch.arange(1, 5)[:, None]
        frames = len(hidden)
        return {
            "backbone_features": hidden,
            "backbone_attention_mask": torch.tensor([[True, True, True, False]]).expand(frames, 4),
            "image_mask": torch.tensor([[True, True, False, False]]).expand(frames, 4),
        }


def test_groot_gives_pictures_words_and_state():
    policy = StandInGroot()
    extractor = GrootFeatures("groot:here", OpenedPolicy(policy, dict, {}, (STATE, "task"), "abc"))
    batch = {STATE: torch.randn(3, 8), "task": ["a", "b", "c"]}
    seen = same_in_any_batch(extractor, batch)
    assert torch.allclose(seen[:, 0], batch[STATE][:, :6] * 1.5)
    assert torch.allclose(seen[:, 1], batch[STATE][:, :6] * 3)
    assert torch.allclose(seen[:, 2, :4], policy._groot_model.action_head.state_encoder(batch[STATE]))
    assert seen[:, 2, 4:].abs().max() == 0
