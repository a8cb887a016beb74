"""Q on a Hugging Face model, built here from a tiny config with random weights: trained, saved, loaded again."""

from dataclasses import replace
from typing import Any

import pytest
import torch  # noqa: TID253  these tests are about tensors

from jiti.critic.backbone import empty_backbone, load_backbone
from jiti.critic.checkpoint import checkpoints
from jiti.critic.critic import load_critic
from jiti.critic.dataset import read_elegant
from jiti.critic.settings_file import settings_from
from jiti.critic.train import train
from jiti.errors import UsageError

TEXT = {
    "hidden_size": 16,
    "intermediate_size": 32,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "num_key_value_heads": 1,
    "vocab_size": 64,
}
VISION = {
    "hidden_size": 16,
    "intermediate_size": 32,
    "num_hidden_layers": 1,
    "num_attention_heads": 2,
    "image_size": 32,
    "patch_size": 16,
}


@pytest.fixture(params=["causal", "vision-language"])
def folder(request, tmp_path):
    import transformers

    torch.manual_seed(0)
    if request.param == "causal":
        model = transformers.Qwen2ForCausalLM(transformers.Qwen2Config(**TEXT))
    else:
        config = transformers.SmolVLMConfig(
            text_config={"model_type": "llama", "pad_token_id": 0, **TEXT},
            vision_config=VISION,
            image_token_id=63,
            pad_token_id=0,
            scale_factor=2,
        )
        model = transformers.SmolVLMForConditionalGeneration(config)
    model.save_pretrained(tmp_path / "model")
    return tmp_path / "model"


def test_padding_and_masked_actions_have_no_influence(folder):
    backbone = load_backbone(str(folder), 5, 2).eval()
    features, chunks = torch.randn(2, 3, 5), torch.randn(2, 4, 6, 2)
    there, mask = torch.ones(2, 3, dtype=torch.bool), torch.ones(2, 6, dtype=torch.bool)
    there[:, 0], mask[:, 4:] = False, False
    other = features.clone()
    other[:, 0] = 9
    seen = backbone(features, there, chunks, mask)
    assert seen.shape == (8, 16)
    torch.testing.assert_close(backbone(other, there, chunks, mask), seen, atol=1e-5, rtol=1e-4)
    fewer = backbone(features[:, 1:], there[:, 1:], chunks[:, :, :4], mask[:, :4])
    torch.testing.assert_close(fewer, seen, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(("checkpointing", "times"), [(True, 2), (False, 1)])
def test_layers_are_computed_again_for_gradients_where_checkpointing_is_asked_for(folder, checkpointing, times):
    backbone = load_backbone(str(folder), 5, 2, gradient_checkpointing=checkpointing)
    counted = []
    first: Any = next(iter(backbone.model.layers))
    first.self_attn.register_forward_pre_hook(lambda *_: counted.append(1))
    there, mask = torch.ones(2, 3, dtype=torch.bool), torch.ones(2, 6, dtype=torch.bool)
    backbone(torch.randn(2, 3, 5), there, torch.randn(2, 4, 6, 2), mask).sum().backward()
    assert len(counted) == times
    assert backbone.project.weight.grad is not None


def test_training_draws_no_dropout(tmp_path):
    import transformers

    for name, model in {
        "gpt2": transformers.GPT2Model(
            transformers.GPT2Config(n_embd=16, n_layer=2, n_head=2, vocab_size=64, n_positions=32)
        ),
        "qwen2": transformers.Qwen2ForCausalLM(transformers.Qwen2Config(**TEXT, attention_dropout=0.5)),
    }.items():
        model.save_pretrained(tmp_path / name)
        backbone = load_backbone(str(tmp_path / name), 5, 2)
        assert backbone.model.training
        there, mask = torch.ones(2, 3, dtype=torch.bool), torch.ones(2, 6, dtype=torch.bool)
        features, chunks = torch.randn(2, 3, 5), torch.randn(2, 4, 6, 2)
        drawn = [backbone(features, there, chunks, mask) for _ in range(2)]
        assert torch.equal(*drawn), name
        torch.testing.assert_close(drawn[0], backbone.eval()(features, there, chunks, mask))


def test_its_pretrained_layers_are_taken(folder):
    one, two = (load_backbone(str(folder), 5, 2) for _ in range(2))
    taken = [name for name, _ in one.model.named_parameters() if "layers" in name]
    assert taken
    for name in taken:
        assert torch.equal(one.model.get_parameter(name), two.model.get_parameter(name))
    assert not torch.equal(one.project.weight, two.project.weight)
    assert isinstance(empty_backbone(one.model.config.to_dict(), 5, 2).model, type(one.model))


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_it_trains_goes_on_and_loads_without_the_model(toy, folder, precision):
    settings = settings_from(
        {
            "network": {"backbone": str(folder), "chunk": 4, "actor_width": 16, "gradient_checkpointing": True},
            "optimizer": {"backbone_lr": 1e-2, "critic_lr": 1e-2},
            "run": {"steps": 2, "batch": 4, "check_every": 2, "precision": precision, "device": "cpu"},
        }
    )
    before = load_backbone(str(folder), 3, 3).model.state_dict()
    out = toy.parent / "run"
    train(toy, out, settings, features_dir=toy.parent / "features")
    longer = replace(settings, run=replace(settings.run, steps=4))
    assert train(toy, out, longer, features_dir=toy.parent / "features").step == 4
    (folder / "model.safetensors").unlink()
    critic = load_critic(checkpoints(out)[0])
    after = critic.q.trunk.model.state_dict()
    assert any(not torch.equal(before[name], after[name]) for name in before)
    data = read_elegant(toy)
    values = critic.values(torch.zeros(3, 1, 3), data.action[:12].reshape(3, 1, 4, 3))
    assert values.shape == (2, 3, 1)
    assert values.isfinite().all()


def test_what_is_no_model_is_named(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match=r"network\.backbone .*empty cannot be loaded.*Hub id"):
        load_backbone(str(tmp_path / "empty"), 5, 2)
