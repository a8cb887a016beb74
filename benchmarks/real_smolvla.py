"""SmolVLA at its real size with random weights, made without the Hub: only its tokenizer is small.

Sizes are those of the `config.json` of HuggingFaceTB/SmolVLM2-500M-Video-Instruct and lerobot's defaults for SmolVLA,
with the chunk of the paper's supplement C.3 and C.4: 50 actions, 10 executed. Two cameras, as in LIBERO.
"""

from pathlib import Path
from typing import Any

TEXT = {
    "model_type": "llama",
    "vocab_size": 49280,
    "hidden_size": 960,
    "intermediate_size": 2560,
    "num_hidden_layers": 32,
    "num_attention_heads": 15,
    "num_key_value_heads": 5,
    "head_dim": 64,
    "rms_norm_eps": 1e-5,
    "rope_theta": 100000,
    "max_position_embeddings": 8192,
}
VISION = {
    "hidden_size": 768,
    "intermediate_size": 3072,
    "num_hidden_layers": 12,
    "num_attention_heads": 12,
    "image_size": 512,
    "patch_size": 16,
}
SMALL_TEXT = TEXT | {"hidden_size": 96, "intermediate_size": 192, "num_attention_heads": 3, "num_key_value_heads": 1}
SMALL_TEXT |= {"head_dim": 32, "vocab_size": 512, "num_hidden_layers": 16}
SMALL_VISION = VISION | {"hidden_size": 96, "intermediate_size": 192, "num_hidden_layers": 2, "image_size": 128}
SCALE = 4
"""Of the pixel shuffle: 64 tokens for a picture of 512 x 512."""
CAMERAS = ("front", "wrist")
STATE, ACTION = 8, 7
_SPECIAL = ("<|endoftext|>", "<image>", "<fake_token_around_image>", "<global-img>", "<end_of_utterance>")


def make_smolvla(folder: Path, *, small: bool) -> tuple[Any, Any, Any]:
    """A policy with lerobot's two pipelines; `folder` gets its config and its VLM's, no weights."""
    import torch
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
    from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy
    from transformers import SmolVLMConfig

    vision = SMALL_VISION if small else VISION
    side = vision["image_size"]
    processor = _processor(side)
    processor.save_pretrained(folder / "vlm")
    ids = processor.tokenizer.convert_tokens_to_ids(list(_SPECIAL))
    SmolVLMConfig(
        text_config=(SMALL_TEXT if small else TEXT) | {"pad_token_id": ids[0]},
        vision_config=vision,
        image_token_id=ids[1],
        pad_token_id=ids[0],
        scale_factor=SCALE,
    ).save_pretrained(folder / "vlm")
    config = SmolVLAConfig(
        device="cpu",
        vlm_model_name=str(folder / "vlm"),
        load_vlm_weights=False,
        resize_imgs_with_padding=(side, side),
        n_action_steps=10,
        push_to_hub=False,
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (STATE,)),
            **{f"observation.images.{c}": PolicyFeature(FeatureType.VISUAL, (3, 256, 256)) for c in CAMERAS},
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (ACTION,))},
    )
    torch.manual_seed(0)
    policy = SmolVLAPolicy(config).eval().requires_grad_(False)
    config.save_pretrained(folder)
    ones = {"observation.state": STATE, "action": ACTION}
    stats = {key: {"mean": torch.zeros(size), "std": torch.ones(size)} for key, size in ones.items()}
    return policy, *make_pre_post_processors(config, dataset_stats=stats)


def _processor(side: int) -> Any:
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers
    from transformers import PreTrainedTokenizerFast, SmolVLMImageProcessor, SmolVLMProcessor, SmolVLMVideoProcessor

    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    alphabet = pre_tokenizers.ByteLevel.alphabet()
    trainer = trainers.BpeTrainer(
        vocab_size=300, special_tokens=list(_SPECIAL), initial_alphabet=alphabet, show_progress=False
    )
    tokenizer.train_from_iterator(["put the bowl on the plate\n"], trainer)
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        eos_token=_SPECIAL[4],
        pad_token=_SPECIAL[0],
        extra_special_tokens={
            "image_token": _SPECIAL[1],
            "fake_image_token": _SPECIAL[2],
            "global_image_token": _SPECIAL[3],
            "end_of_utterance_token": _SPECIAL[4],
        },
    )
    size = {"longest_edge": side}
    images, videos = (kind(size=size, max_image_size=size) for kind in (SmolVLMImageProcessor, SmolVLMVideoProcessor))
    return SmolVLMProcessor(images, fast, videos, image_seq_len=(side // 16 // SCALE) ** 2)
