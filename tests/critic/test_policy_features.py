"""Features of policies: the same for a frame in any batch, from SmolVLA, GR00T and any policy of lerobot."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.critic.features import open_extractor  # noqa: E402
from jiti.critic.features.groot import GrootFeatures  # noqa: E402
from jiti.critic.features.opened_policy import OpenedPolicy  # noqa: E402
from jiti.errors import UsageError  # noqa: E402

# lerobot and transformers warn of their own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")

STATE, SCENE = "observation.state", "observation.environment_state"
FRONT, WRIST = "observation.images.front", "observation.images.wrist"
SHAPES = {STATE: (8,), SCENE: (5,), "action": (7,)}
SIDE = 32


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def rows(batch, which):
    return {k: [v[i] for i in which] if isinstance(v, list) else v[which] for k, v in batch.items()}


def same_in_any_batch(extractor, batch):
    whole = extractor.features(batch)
    frames = len(batch["task"])
    assert whole.shape == (frames, extractor.tokens, extractor.size)
    assert not whole.requires_grad
    alone = torch.cat([extractor.features(rows(batch, [i])) for i in range(frames)])
    assert torch.allclose(whole, alone, atol=1e-5)
    turned = extractor.features(rows(batch, [2, 0, 1]))
    assert torch.allclose(turned, whole[[2, 0, 1]], atol=1e-5)
    return whole


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    """A checkpoint of our own policy, as `lerobot-train` leaves one."""
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import make_pre_post_processors

    from jiti.policies.configuration_state_flow import StateFlowConfig
    from jiti.policies.modeling_state_flow import StateFlowPolicy

    config = StateFlowConfig(
        device="cpu",
        width=16,
        depth=1,
        instructions=["put it there", "push it away"],
        input_features={
            STATE: PolicyFeature(FeatureType.STATE, (8,)),
            SCENE: PolicyFeature(FeatureType.ENV, (5,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (7,))},
    )
    run = tmp_path_factory.mktemp("run")
    folder = run / "checkpoints" / "last" / "pretrained_model"
    StateFlowPolicy(config).save_pretrained(folder)
    stats = {key: {"mean": torch.zeros(n), "std": torch.ones(n)} for key, n in ((STATE, 8), (SCENE, 5), ("action", 7))}
    for part in make_pre_post_processors(config, dataset_stats=stats):
        part.save_pretrained(folder)
    return run


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
    with pytest.raises(UsageError, match="no folder here"):
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


@pytest.fixture(scope="module")
def smolvla(tmp_path_factory):
    pytest.importorskip("num2words", reason="needs pip install num2words")
    from tests.builders.tiny_smolvla import build_smolvla, build_vlm

    folder = tmp_path_factory.mktemp("models")
    vlm = build_vlm(folder / "vlm")
    return vlm, build_smolvla(folder / "smolvla", vlm)


PICTURES = {STATE: (8,), FRONT: (SIDE, SIDE, 3), WRIST: (SIDE, SIDE, 3), "action": (7,)}


def seen(frames=3):
    pictures = {key: torch.rand(frames, 3, SIDE, SIDE) for key in (FRONT, WRIST)}
    said = ["put the bowl on the plate", "put", "the plate"][:frames]
    return {STATE: torch.randn(frames, 8), **pictures, "task": said}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_smolvla_gives_cameras_words_and_state(smolvla):
    extractor = open_extractor(f"smolvla:{smolvla[1]}", PICTURES)
    assert extractor.tokens == 4
    batch = seen()
    whole = same_in_any_batch(extractor, batch)
    other = extractor.features(batch | {FRONT: torch.rand(3, 3, SIDE, SIDE)})
    assert not torch.allclose(whole[:, 0], other[:, 0])
    assert not torch.allclose(whole, extractor.features(batch | {"task": ["a", "b", "c"]}))
    # State is what nothing else looks at.
    moved = extractor.features(batch | {STATE: torch.randn(3, 8)})
    assert torch.allclose(whole[:, :3], moved[:, :3], atol=1e-5)
    assert not torch.allclose(whole[:, 3], moved[:, 3])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_all_tokens_of_smolvla_have_the_means_of_the_few(smolvla):
    few = open_extractor(f"smolvla:{smolvla[1]}", PICTURES)
    every = open_extractor(f"smolvla:{smolvla[1]}#all", PICTURES)
    batch = seen()
    tokens = same_in_any_batch(every, batch)
    means = few.features(batch)
    side = (every.tokens - 1 - 48) // 2
    assert torch.allclose(tokens[:, :side].mean(1), means[:, 0], atol=1e-5)
    words = tokens[:, 2 * side : -1]
    there = (words.abs().sum(-1, keepdim=True) > 0).sum(1)
    assert torch.allclose(words.sum(1) / there, means[:, 2], atol=1e-5)
    assert there.flatten().tolist() != [48] * 3
    with pytest.raises(UsageError, match="all"):
        open_extractor(f"smolvla:{smolvla[1]}#some", PICTURES)
    with pytest.raises(UsageError, match="needs pictures"):
        open_extractor(f"smolvla:{smolvla[1]}", SHAPES)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_critic_on_a_hugging_face_backbone_learns_from_smolvla_and_is_opened_again(smolvla, tmp_path):
    from jiti.critic.critic import load_critic
    from jiti.critic.settings_file import settings_from
    from jiti.critic.train import train

    vlm, policy = smolvla
    root = elegant_with_pictures(tmp_path / "elegant")
    name = f"smolvla:{policy}"
    settings = settings_from(
        {
            "data": {"features": name},
            "network": {"backbone": str(vlm), "actor_width": 16},
            "run": {"steps": 3, "batch": 4, "check_every": 3, "log_every": 1},
        }
    )
    trained = train(root, tmp_path / "run", settings, features_dir=tmp_path / "features")
    assert trained.step == 3
    critic = load_critic(tmp_path / "run")
    again = load_critic(tmp_path / "run")
    extractor = open_extractor(name, PICTURES)
    features = extractor.features(seen()).clone()
    chunks = np.random.default_rng(0).uniform(-1, 1, (3, 8, 10, 7))
    values = critic.values(features, chunks)
    assert values.shape == (2, 3, 8)
    assert torch.isfinite(values).all()
    assert torch.equal(values, again.values(features, chunks))


def elegant_with_pictures(root):
    """Six short episodes with two cameras, half of them elegant, as LeRobot's own writer leaves them."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from jiti.curate.returns import mc_returns

    def numbers(size, dtype="float32"):
        return {"dtype": dtype, "shape": (size,), "names": None}

    picture = {"dtype": "image", "shape": (SIDE, SIDE, 3), "names": ["height", "width", "channels"]}
    features = {STATE: numbers(8), "action": numbers(7), FRONT: picture, WRIST: picture}
    features |= {"next.reward": numbers(1), "elegance.annotated": numbers(1, "bool"), "elegance.mc_return": numbers(1)}
    made = LeRobotDataset.create("local/elegant", fps=20, root=root, use_videos=False, features=features)
    rng = np.random.default_rng(0)
    length, window = 16, slice(8, 14)
    for episode in range(6):
        annotated = np.zeros(length, bool)
        annotated[window] = True
        reward = (annotated * (episode % 2)).astype(np.float32)
        returns = mc_returns(reward, np.array([0, length]), 0.98)
        for frame in range(length):
            made.add_frame(
                {
                    STATE: rng.normal(size=8).astype(np.float32),
                    "action": rng.uniform(-1, 1, 7).astype(np.float32),
                    FRONT: rng.integers(0, 255, (SIDE, SIDE, 3), np.uint8),
                    WRIST: rng.integers(0, 255, (SIDE, SIDE, 3), np.uint8),
                    "next.reward": reward[[frame]],
                    "elegance.annotated": annotated[[frame]],
                    "elegance.mc_return": returns[[frame]].astype(np.float32),
                    "task": "put the bowl on the plate",
                }
            )
        made.save_episode()
    made.finalize()
    (root / "meta/jiti").mkdir()
    (root / "meta/jiti/curate.json").write_text(json.dumps({"gamma": 0.98, "fps": 20}))
    columns = {
        "episode_index": pa.array(range(6), pa.int64()),
        "episode_id": [f"recorded_{n}" for n in range(6)],
        "fingerprint": [f"{n:016x}" for n in range(6)],
        "task_id": ["elegant/T2"] * 6,
        "split": ["train"] * 4 + ["validation"] * 2,
        "frames": pa.array([length] * 6, pa.int64()),
    }
    pq.write_table(pa.table(columns), root / "meta/jiti/episodes.parquet")
    return root
