"""lerobot's own parser takes the recipes, and they hold the supplement's numbers."""

import json
import traceback

import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.errors import UsageError  # noqa: E402
from jiti.policies import RECIPES, recipe_path, register  # noqa: E402

# lerobot warns of its own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")


def parsed(name: str, tmp_path, *more: str):
    """As `lerobot-train --config_path=...` has it before it reads data."""
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.scripts import lerobot_train  # noqa: F401 - registers all of lerobot's policies

    register()
    arguments = [f"--dataset.root={tmp_path}", f"--output_dir={tmp_path / 'run'}", "--policy.device=cpu", *more]
    config = TrainPipelineConfig.from_pretrained(recipe_path(name), cli_args=arguments)
    config.validate()
    return config


PAPER = {
    # Supplement C.3, C.1 and C.2.
    "smolvla": {"steps": 100_000, "batch": 64, "lr": 1e-4, "warmup": 1_000, "save": 25_000},
    "pi05": {"steps": 30_000, "batch": 8, "lr": 5e-5, "warmup": 10_000, "save": 10_000},
    "groot": {"steps": 50_000, "batch": 16, "lr": 1e-4, "warmup": 2_500, "save": 5_000},
}


@pytest.mark.parametrize("name", PAPER)
def test_a_recipe_makes_the_supplements_optimizer_and_schedule(name, tmp_path):
    paper = PAPER[name]
    config = parsed(name, tmp_path)
    assert (config.steps, config.batch_size, config.save_freq) == (paper["steps"], paper["batch"], paper["save"])
    weights = torch.nn.Linear(2, 2)
    optimizer = config.optimizer.build(weights.parameters())
    assert isinstance(optimizer, torch.optim.AdamW)
    if name == "groot":
        pytest.importorskip("diffusers", reason="the schedule of lerobot's GR00T needs pip install diffusers")
    schedule = config.scheduler.build(optimizer, config.steps)
    rate = [paper["lr"] * schedule.lr_lambdas[0](step) for step in range(0, paper["steps"], 50)]
    warm = paper["warmup"] // 50
    assert rate[0] < 0.01 * paper["lr"]
    assert rate[warm // 2] == pytest.approx(paper["lr"] / 2, rel=0.01)
    # lerobot's cosine goes down from the first step on, beside the warm-up, and not from its end.
    assert max(rate) == pytest.approx(paper["lr"], rel=0.26 if name == "pi05" else 0.01)
    assert rate[-1] < 0.11 * paper["lr"]


def test_smolvla_has_the_supplements_betas_and_full_precision(tmp_path):
    config = parsed("smolvla", tmp_path)
    optimizer = config.optimizer.build(torch.nn.Linear(2, 2).parameters())
    assert optimizer.defaults["betas"] == (0.9, 0.95)
    assert optimizer.defaults["eps"] == 1e-8
    assert not config.policy.use_amp
    assert config.env_eval_freq == 20_000


def observed(policy_config):
    """A policy's config with the supplement's observations: two cameras, 8 numbers of state, actions of 7."""
    from lerobot.configs.types import FeatureType, PolicyFeature

    policy_config.input_features = {
        "observation.state": PolicyFeature(FeatureType.STATE, (8,)),
        "observation.images.front": PolicyFeature(FeatureType.VISUAL, (3, 224, 224)),
        "observation.images.wrist": PolicyFeature(FeatureType.VISUAL, (3, 224, 224)),
    }
    policy_config.output_features = {"action": PolicyFeature(FeatureType.ACTION, (7,))}
    return policy_config


def test_pi05_trains_lora_on_the_backbone_and_all_of_the_action_head(tmp_path):
    import re

    from lerobot.policies.factory import get_policy_class

    config = parsed("pi05", tmp_path)
    assert config.policy.dtype == "bfloat16"
    assert (config.optimizer.grad_clip_norm, config.optimizer.weight_decay) == (1.0, 1e-10)  # openpi's
    assert len(config.policy.action_delta_indices) == 10
    # Whole and without memory: 4 billion weights that are shapes only.
    config.policy.device = "meta"
    with torch.device("meta"):
        policy = get_policy_class("pi05")(observed(config.policy))
    assert sum(weight.numel() for weight in policy.parameters()) > 3e9
    linear = [name for name, module in policy.named_modules() if isinstance(module, torch.nn.Linear)]
    backbone = "model.paligemma_with_expert.paligemma."
    left = {backbone + "lm_head", backbone + "model.multi_modal_projector.linear"}
    adapted = {name for name in linear if re.fullmatch(config.peft.target_modules, name)}
    assert adapted == {name for name in linear if name.startswith(backbone)} - left
    whole = [name for name, _ in policy.named_modules() if name.split(".")[-1] in config.peft.full_training_modules]
    assert len(whole) == len(config.peft.full_training_modules)
    head = [name for name in linear if not name.startswith(backbone)]
    assert all(any(name == part or name.startswith(part + ".") for part in whole) for name in head)


def test_groots_class_is_found_and_takes_its_weights_from_the_hub(tmp_path):
    from lerobot.policies.factory import get_policy_class

    config = parsed("groot", tmp_path)
    assert get_policy_class(config.policy.type).__name__ == "GrootPolicy"
    assert config.policy.base_model_path == "nvidia/GR00T-N1.7-3B"


def test_groot_leaves_vision_and_language_as_they_are(tmp_path):
    policy = parsed("groot", tmp_path).policy
    assert (policy.tune_llm, policy.tune_visual, policy.lora_rank) == (False, False, 0)
    assert (policy.tune_projector, policy.tune_diffusion_model, policy.use_bf16) == (True, True, True)
    assert policy.optimizer_weight_decay == 1e-5


def test_groot_n15_is_for_an_older_lerobot_and_this_one_says_so(tmp_path):
    with pytest.raises(Exception) as refused:  # noqa: PT011 - draccus wraps it in an error of its own
        parsed("groot_n15", tmp_path)
    assert "lerobot==0.5.1" in "".join(traceback.format_exception(refused.value))
    recipe = json.loads(recipe_path("groot_n15").read_text())
    assert (recipe["steps"], recipe["batch_size"]) == (50_000, 16)
    assert (recipe["optimizer"]["lr"], recipe["optimizer"]["weight_decay"]) == (1e-4, 1e-5)
    assert recipe["scheduler"]["num_warmup_steps"] == 0.05 * 50_000


def test_our_own_recipe_is_small(tmp_path):
    config = parsed("state_flow", tmp_path)
    assert config.policy.chunk_size == config.policy.n_action_steps == 10
    assert config.steps * config.batch_size * config.policy.draws <= 30_000 * 256, "half an hour of a core"


def test_a_recipe_that_there_is_not_is_answered_with_those_that_there_are():
    with pytest.raises(UsageError, match="state_flow"):
        recipe_path("gpt")
    assert set(PAPER) < set(RECIPES)


@pytest.mark.slow
def test_smolvla_of_the_recipe_learns_with_random_weights(tmp_path):
    pytest.importorskip("num2words", reason="needs pip install num2words")
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    from tests.builders.tiny_smolvla import SIDE, build_vlm

    vlm = build_vlm(tmp_path / "vlm")
    small = ["--policy.num_vlm_layers=2", f"--policy.resize_imgs_with_padding=[{SIDE},{SIDE}]"]
    offline = [f"--policy.vlm_model_name={vlm}", "--policy.load_vlm_weights=false", "--policy.pretrained_path=null"]
    config = parsed("smolvla", tmp_path, *small, *offline)
    policy_config = config.policy
    policy_config.input_features = {
        "observation.state": PolicyFeature(FeatureType.STATE, (8,)),
        "observation.images.front": PolicyFeature(FeatureType.VISUAL, (3, SIDE, SIDE)),
    }
    policy_config.output_features = {"action": PolicyFeature(FeatureType.ACTION, (7,))}
    policy = get_policy_class("smolvla")(policy_config)
    one = {"mean": torch.zeros(1), "std": torch.ones(1)}
    before, _ = make_pre_post_processors(policy_config, dataset_stats={"observation.state": one, "action": one})
    batch = before(
        {
            "observation.state": torch.randn(2, 8),
            "observation.images.front": torch.rand(2, 3, SIDE, SIDE),
            "action": torch.randn(2, policy_config.chunk_size, 7),
            "task": ["put the bowl on the plate"] * 2,
        }
    )
    vision = policy.model.vlm_with_expert.get_vlm_model().vision_model
    assert not any(weight.requires_grad for weight in vision.parameters())
    optimizer = config.optimizer.build(p for p in policy.parameters() if p.requires_grad)
    held = next(vision.parameters()).clone()
    loss, _ = policy.train().forward(batch)
    loss.backward()
    optimizer.step()
    assert torch.isfinite(loss)
    assert torch.equal(next(vision.parameters()), held)
