"""Every kind of lerobot policy that draws chunks from noise: the same as its own way, whatever the batch."""

import copy
from importlib.util import find_spec
from inspect import signature
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.errors import UsageError  # noqa: E402
from jiti.runtime.candidates import open_sampler  # noqa: E402
from jiti.runtime.candidates.source import KINDS  # noqa: E402
from tests.runtime.candidates.conftest import FRONT, TOLD, WRIST, checkpoint, inputs, observation  # noqa: E402

# lerobot and transformers warn of their own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")

needs_diffusers = pytest.mark.skipif(find_spec("diffusers") is None, reason="needs pip install 'lerobot[diffusion]'")


def drawn(n, shape, seed=0):
    return np.random.default_rng(seed).standard_normal((n, *shape), dtype=np.float32)


def same_in_any_batch(source, looked, noise):
    """Chunks of a batch, which are those of each noise alone; torch's random numbers are left alone."""
    before = torch.get_rng_state()
    with torch.inference_mode():
        whole = source.draw(looked, noise, source.chunk)
        alone = torch.cat([source.draw(looked, row, source.chunk) for row in noise.split(1)])
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.allclose(whole, alone, atol=1e-4)
    assert (whole[0] - whole[1]).abs().max() > 1e-3
    return whole


def test_every_kind_is_a_policy_of_lerobots_or_ours():
    import lerobot.policies.factory  # noqa: F401 - makes lerobot's own known
    from lerobot.configs.policies import PreTrainedConfig

    import jiti.policies

    jiti.policies.register()
    assert set(KINDS) <= set(PreTrainedConfig.get_known_choices())


# Diffusion Policy


def diffusion(**changed):
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    torch.manual_seed(0)
    options = {
        "device": "cpu",
        "horizon": 16,
        "n_action_steps": 8,
        "down_dims": (8, 16),
        "n_groups": 2,
        "diffusion_step_embed_dim": 8,
        "num_train_timesteps": 10,
        "pretrained_backbone_weights": None,
        "spatial_softmax_num_keypoints": 4,
        "push_to_hub": False,
    }
    return DiffusionPolicy(DiffusionConfig(**options | inputs(cameras=(FRONT,), side=64) | changed))


def steps(number):
    return [observation(seed, cameras=(FRONT,), side=64) for seed in range(number)]


@needs_diffusers
@pytest.mark.parametrize("scheduler", ["DDPM", "DDIM"])
def test_diffusion_draws_what_select_action_executes(scheduler, tmp_path):
    sampler = open_sampler(checkpoint(diffusion(noise_scheduler_type=scheduler), tmp_path))
    assert (sampler.noise_shape, sampler.chunk, sampler.executed, sampler.history) == ((16, 7), 15, 8, 2)
    noise = drawn(3, sampler.noise_shape)
    before, now = steps(2)
    seen = sampler.observe(now, TOLD, [before])
    chunks = seen.sample(noise)
    assert np.allclose(chunks, np.concatenate([seen.sample(row[None]) for row in noise]), atol=1e-4)
    assert np.ptp(chunks, axis=0).max() > 1e-3
    if scheduler == "DDPM":
        return
    # DDIM adds no noise of its own, so that lerobot's own way can be given the same.
    policy = sampler.base.policy
    policy.reset()
    batches = [sampler.base.renamed({**_batch(step)}) for step in (before, now)]
    first, second = (sampler.base.preprocess(batch) for batch in batches)
    # The queues are filled by the first step, whose chunk is left aside.
    policy.select_action(first, noise=torch.from_numpy(noise[:1]))
    policy._queues["action"].clear()
    by_hand = [policy.select_action(second, noise=torch.from_numpy(noise[:1]))]
    by_hand += [policy._queues["action"][k] for k in range(7)]
    assert np.allclose(sampler.base.postprocess(torch.cat(by_hand)).numpy(), chunks[0, :8], atol=1e-4)


def _batch(step):
    from jiti.runtime.candidates.observation import as_batch

    return as_batch(step, TOLD)


@needs_diffusers
def test_without_earlier_observations_the_first_stands_for_them(tmp_path):
    sampler = open_sampler(checkpoint(diffusion(), tmp_path))
    noise, (before, now) = drawn(2, sampler.noise_shape), steps(2)
    alone = sampler.observe(now, TOLD).sample(noise)
    assert np.array_equal(alone, sampler.observe(now, TOLD, [now]).sample(noise))
    assert np.array_equal(alone, sampler.observe(now, TOLD, [before, now]).sample(noise))
    assert not np.allclose(alone, sampler.observe(now, TOLD, [before]).sample(noise))


# The multi-task diffusion transformer


def clip(folder):
    """Both halves of a CLIP of some thousand weights."""
    from transformers import CLIPConfig, CLIPModel

    small = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2}
    config = CLIPConfig(
        text_config=small | {"vocab_size": 50, "max_position_embeddings": 8, "eos_token_id": 49},
        vision_config=small | {"image_size": 32, "patch_size": 16},
        projection_dim=16,
    )
    CLIPModel(config).save_pretrained(folder)
    return str(folder)


@needs_diffusers
@pytest.mark.parametrize("objective", ["diffusion", "flow_matching", "rk4"])
def test_multi_task_dit_draws_what_it_would(objective, tmp_path):
    from lerobot.policies.multi_task_dit.configuration_multi_task_dit import MultiTaskDiTConfig
    from lerobot.policies.multi_task_dit.modeling_multi_task_dit import MultiTaskDiTPolicy

    from jiti.runtime.candidates.multi_task_dit import open_source

    torch.manual_seed(0)
    name = clip(tmp_path / "clip")
    chosen = {"objective": objective} if objective != "rk4" else {"objective": "flow_matching"}
    policy = MultiTaskDiTPolicy(
        MultiTaskDiTConfig(
            device="cpu",
            horizon=16,
            n_action_steps=8,
            hidden_dim=16,
            num_layers=1,
            num_heads=2,
            timestep_embed_dim=8,
            num_train_timesteps=10,
            num_integration_steps=5,
            integration_method="rk4" if objective == "rk4" else "euler",
            vision_encoder_name=name,
            text_encoder_name=name,
            image_crop_shape=None,
            **chosen,
            **inputs(scene=0, cameras=(FRONT, WRIST)),
        )
    ).eval()
    with torch.no_grad():
        for weight in policy.noise_predictor.parameters():
            weight.normal_(0, 0.3)
    torch.manual_seed(1)
    prepared = [
        {
            "observation.state": torch.randn(1, 8),
            FRONT: torch.rand(1, 3, 32, 32),
            WRIST: torch.rand(1, 3, 32, 32),
            "observation.language.tokens": torch.tensor([[1, 2, 49]]),
            "observation.language.attention_mask": torch.ones(1, 3, dtype=torch.long),
        }
        for _ in range(2)
    ]
    source = open_source(policy)
    noise = torch.from_numpy(drawn(3, source.noise_shape))
    with torch.inference_mode():
        looked = source.look([dict(step) for step in prepared])
    chunks = same_in_any_batch(source, looked, noise)
    assert chunks.shape == (3, 15, 7)
    if objective == "diffusion":
        return
    for step in prepared:
        policy._queues["action"].clear()
        # What it draws at its start is the noise that is given here.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(torch, "randn", lambda *_, **__: noise[:1])
            first = policy.select_action(dict(step))
    rest = [policy._queues["action"][k] for k in range(7)]
    assert torch.allclose(torch.cat([first, *rest]), chunks[0, :8], atol=1e-5)


# pi0 and pi0.5


@pytest.fixture
def small_gemma(monkeypatch):
    """lerobot fixes the sizes of PaliGemma and its expert; here all of them are tiny."""
    import importlib

    from transformers import GemmaConfig, PaliGemmaConfig

    def paligemma():
        vision = {"hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "patch_size": 16}
        return PaliGemmaConfig(
            vision_config=vision | {"model_type": "siglip_vision_model", "intermediate_size": 16},
            text_config={"model_type": "gemma", "hidden_size": 16, "vocab_size": 128},
            projection_dim=16,
        )

    def small(name):
        module = importlib.import_module(f"lerobot.policies.{name}.modeling_{name}")
        config = module.GemmaConfig(width=16, depth=2, mlp_dim=16, num_heads=8, num_kv_heads=1, head_dim=8)
        from lerobot.policies import pi_gemma

        made = pi_gemma.create_causal_mask
        if "cache_position" not in signature(made).parameters:
            # lerobot 0.6.1 asks for transformers below 5.6, which still took it.
            monkeypatch.setattr(pi_gemma, "create_causal_mask", lambda cache_position=None, **given: made(**given))
        monkeypatch.setattr(module, "get_gemma_config", lambda _variant: copy.copy(config))
        monkeypatch.setattr(module, "CONFIG_MAPPING", {"paligemma": paligemma, "gemma": GemmaConfig})
        return module

    return small


@pytest.mark.parametrize("name", ["pi0", "pi05"])
def test_pi_draws_what_the_whole_policy_gives(name, small_gemma):
    from lerobot.configs.policies import PreTrainedConfig

    from jiti.runtime.candidates.pi import open_source

    module = small_gemma(name)
    config = PreTrainedConfig.get_choice_class(name)(
        device="cpu",
        chunk_size=10,
        n_action_steps=10,
        max_state_dim=8,
        max_action_dim=12,
        num_inference_steps=4,
        image_resolution=(32, 32),
        dtype="float32",
        **inputs(scene=0, cameras=(FRONT, WRIST)),
    )
    torch.manual_seed(0)
    policy = {"pi0": "PI0Policy", "pi05": "PI05Policy"}[name]
    policy = getattr(module, policy)(config).eval()
    # Its output is 2048, whatever the sizes.
    policy.model.paligemma_with_expert.paligemma.model.multi_modal_projector.linear = torch.nn.Linear(16, 16)
    with torch.no_grad():
        for weight in policy.parameters():
            weight.normal_(0, 0.1)
    prepared = {
        "observation.state": torch.randn(1, 8),
        FRONT: torch.rand(1, 3, 32, 32),
        WRIST: torch.rand(1, 3, 32, 32),
        "observation.language.tokens": torch.tensor([[1, 2, 3, 0]]),
        "observation.language.attention_mask": torch.tensor([[True, True, True, False]]),
    }
    source = open_source(policy)
    assert (source.noise_shape, source.chunk) == ((10, 12), 10)
    noise = torch.from_numpy(drawn(3, source.noise_shape))
    with torch.inference_mode():
        looked = source.look([dict(prepared)])
    chunks = same_in_any_batch(source, looked, noise)
    assert chunks.shape == (3, 10, 7)
    for row, chunk in zip(noise, chunks, strict=True):
        whole = policy.predict_action_chunk(dict(prepared), noise=row[None])
        assert torch.allclose(whole[0], chunk, atol=1e-4)


def test_pi_is_refused_with_a_transformers_that_it_does_not_run_with(monkeypatch):
    from lerobot.policies import pi_gemma

    from jiti.runtime.candidates.pi import open_source

    monkeypatch.setattr(pi_gemma, "create_causal_mask", lambda attention_mask: None)
    with pytest.raises(UsageError, match="does not run pi0 with transformers"):
        open_source(SimpleNamespace(config=SimpleNamespace(type="pi0")))


# GR00T


class StandInBackbone(torch.nn.Module):
    """The real one needs 3B weights; what the action head gets of it, by its names."""

    def __init__(self):
        super().__init__()
        self.asked = 0
        self.layer = torch.nn.Linear(8, 12)

    def prepare_input(self, batch):
        return batch

    def forward(self, batch):
        from transformers import BatchFeature

        self.asked += 1
        hidden = self.layer(batch["state"][:, 0, :8]).unsqueeze(1) * torch.arange(1, 6)[:, None]
        return BatchFeature(
            data={
                "backbone_features": hidden,
                "backbone_attention_mask": torch.tensor([[True, True, True, True, False]]).expand(len(hidden), -1),
                "image_mask": torch.tensor([[True, True, False, False, False]]).expand(len(hidden), -1),
            }
        )


@needs_diffusers
@pytest.mark.parametrize("alternate", [True, False])
def test_groot_draws_what_get_action_gives(alternate, monkeypatch):
    """lerobot's own action head and model class, at a tiny size, on a backbone that stands in."""
    pytest.importorskip("tree", reason="needs pip install dm-tree")
    from lerobot.policies.groot import groot_n1_7
    from lerobot.policies.groot.modeling_groot import GrootPolicy

    from jiti.critic.features.groot import GrootFeatures
    from jiti.critic.features.opened_policy import OpenedPolicy
    from jiti.runtime.candidates.groot import open_source

    torch.manual_seed(0)
    monkeypatch.setattr(groot_n1_7, "get_backbone_cls", lambda _config: lambda **_: StandInBackbone())
    config = groot_n1_7.GR00TN17Config(
        backbone_embedding_dim=12,
        hidden_size=16,
        input_embedding_dim=16,
        max_action_dim=9,
        max_state_dim=8,
        action_horizon=12,
        max_num_embodiments=3,
        num_inference_timesteps=4,
        use_alternate_vl_dit=alternate,
        add_pos_embed=True,
        max_seq_len=32,
        use_vlln=True,
        vl_self_attention_cfg=None,
        state_history_length=1,
        diffusion_model_cfg={
            "num_attention_heads": 2,
            "attention_head_dim": 8,
            "output_dim": 16,
            "num_layers": 4,
            "interleave_self_attention": True,
            "norm_type": "ada_norm",
        },
    )
    policy = GrootPolicy.__new__(GrootPolicy)
    torch.nn.Module.__init__(policy)
    policy._groot_model = groot_n1_7.GR00TN17(config).eval().float()
    policy.config = SimpleNamespace(
        type="groot",
        use_bf16=False,
        chunk_size=12,
        n_action_steps=10,
        base_model_path="nothing",
        embodiment_tag="new_embodiment",
        output_features=inputs()["output_features"],
    )
    with torch.no_grad():
        for weight in policy.parameters():
            weight.normal_(0, 0.2)
    prepared = {"state": torch.randn(1, 1, 8), "embodiment_id": torch.tensor([1])}
    source = open_source(policy)
    assert (source.noise_shape, source.chunk) == ((12, 9), 10)
    noise = torch.from_numpy(drawn(3, source.noise_shape))
    backbone = policy._groot_model.backbone
    with torch.inference_mode():
        looked = source.look([dict(prepared)])
    chunks = same_in_any_batch(source, looked, noise)
    assert backbone.asked == 1
    assert chunks.shape == (3, 10, 7)
    for row, chunk in zip(noise, chunks, strict=True):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(torch, "randn", lambda row=row, **_: row[None].clone())
            whole = GrootPolicy.predict_action_chunk(policy, dict(prepared))
        assert torch.allclose(whole[0], chunk, atol=1e-5)
    # The critic's features, of the same look at the observation.
    policy._action_queue_steps = 10
    extractor = GrootFeatures("groot:here", OpenedPolicy(policy, dict, {}, tuple(prepared), "abc"))
    features = extractor.features(prepared)
    assert features.shape == (1, extractor.tokens, extractor.size)
    assert torch.allclose(source.features(looked, ""), features, atol=1e-5)
