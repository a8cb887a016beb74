"""A SmolVLM of some 100,000 weights in a folder, and a SmolVLA on it: real classes and files, random weights."""

from pathlib import Path

SPECIAL = ("<|endoftext|>", "<image>", "<fake_token_around_image>", "<global-img>", "<end_of_utterance>")
SIDE = 32
"""Pixels of a picture's side: four patches a side, one token after pixel shuffle."""


def build_vlm(folder: Path) -> Path:
    """A vision-language model with its processor, as `save_pretrained` writes them."""
    import torch
    from transformers import SmolVLMConfig, SmolVLMForConditionalGeneration

    processor = _processor()
    processor.save_pretrained(folder)
    ids = dict(zip(SPECIAL, processor.tokenizer.convert_tokens_to_ids(list(SPECIAL)), strict=True))
    config = SmolVLMConfig(
        text_config={
            "model_type": "llama",
            "vocab_size": len(processor.tokenizer),
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_hidden_layers": 2,
            "num_attention_heads": 4,
            "num_key_value_heads": 2,
            "head_dim": 8,
            "pad_token_id": ids["<|endoftext|>"],
        },
        vision_config={
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "image_size": SIDE,
            "patch_size": 8,
        },
        image_token_id=ids["<image>"],
        pad_token_id=ids["<|endoftext|>"],
        scale_factor=2,
    )
    torch.manual_seed(0)
    SmolVLMForConditionalGeneration(config).save_pretrained(folder)
    return folder


def build_smolvla(folder: Path, vlm: Path, *, cameras: tuple[str, ...] = ("front", "wrist"), state: int = 8) -> Path:
    """A SmolVLA checkpoint as `lerobot-train` writes it: random weights, statistics of the standard normal."""
    import torch
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
    from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy

    config = SmolVLAConfig(
        device="cpu",
        vlm_model_name=str(vlm),
        load_vlm_weights=False,
        num_vlm_layers=2,
        resize_imgs_with_padding=(SIDE, SIDE),
        chunk_size=10,
        n_action_steps=10,
        push_to_hub=False,
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (state,)),
            **{f"observation.images.{c}": PolicyFeature(FeatureType.VISUAL, (3, SIDE, SIDE)) for c in cameras},
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (7,))},
    )
    torch.manual_seed(1)
    SmolVLAPolicy(config).save_pretrained(folder)
    stats = {
        "observation.state": {"mean": torch.zeros(state), "std": torch.ones(state)},
        "action": {"mean": torch.zeros(7), "std": torch.ones(7)},
    }
    for part in make_pre_post_processors(config, dataset_stats=stats):
        part.save_pretrained(folder)
    return folder


def _processor():
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers
    from transformers import PreTrainedTokenizerFast, SmolVLMImageProcessor, SmolVLMProcessor, SmolVLMVideoProcessor

    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    trainer = trainers.BpeTrainer(
        vocab_size=300,
        special_tokens=list(SPECIAL),
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    tokenizer.train_from_iterator(["put the bowl on the plate\n"], trainer)
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        eos_token="<end_of_utterance>",
        pad_token="<|endoftext|>",
        extra_special_tokens={
            "image_token": "<image>",
            "fake_image_token": "<fake_token_around_image>",
            "global_image_token": "<global-img>",
            "end_of_utterance_token": "<end_of_utterance>",
        },
    )
    size = {"longest_edge": SIDE}
    images = SmolVLMImageProcessor(size=size, max_image_size=size)
    return SmolVLMProcessor(images, fast, SmolVLMVideoProcessor(size=size, max_image_size=size), image_seq_len=4)
