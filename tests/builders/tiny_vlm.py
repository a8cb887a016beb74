"""A Qwen3-VL of 100,000 weights, built and, where asked for, overfitted on the spot: real classes, real files."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jiti.annotate.vlm.backend import Prompt

SPECIAL = (
    "<|endoftext|>",
    "<|im_start|>",
    "<|im_end|>",
    "<|vision_start|>",
    "<|vision_end|>",
    "<|image_pad|>",
    "<|video_pad|>",
)
CHAT_TEMPLATE = (
    "{%- for message in messages -%}"
    "<|im_start|>{{ message.role }}\n"
    "{%- if message.content is string -%}{{ message.content }}{%- else -%}"
    "{%- for part in message.content -%}"
    "{%- if part.type in ('image', 'image_url') -%}<|vision_start|><|image_pad|><|vision_end|>"
    "{%- elif part.type == 'text' -%}{{ part.text }}{%- endif -%}"
    "{%- endfor -%}{%- endif -%}<|im_end|>\n"
    "{%- endfor -%}"
    "{%- if add_generation_prompt -%}<|im_start|>assistant\n{%- endif -%}"
)
SIDE = 64
"""Pixels to which any picture is shrunk: four tokens."""


def build(folder: Path) -> Path:
    """An untrained model in a folder, as `save_pretrained` writes it."""
    import torch
    from transformers import Qwen3VLConfig, Qwen3VLForConditionalGeneration

    processor = _processor()
    processor.save_pretrained(folder)
    size = len(processor.tokenizer)
    ids = dict(zip(SPECIAL, processor.tokenizer.convert_tokens_to_ids(list(SPECIAL)), strict=True))
    config = Qwen3VLConfig(
        text_config={
            "vocab_size": size,
            "hidden_size": 64,
            "intermediate_size": 128,
            "num_hidden_layers": 2,
            "num_attention_heads": 4,
            "num_key_value_heads": 2,
            "head_dim": 16,
            "max_position_embeddings": 8192,
            "rope_parameters": {"rope_type": "default", "rope_theta": 10000.0, "mrope_section": [4, 2, 2]},
            "tie_word_embeddings": True,
            "eos_token_id": ids["<|im_end|>"],
            "pad_token_id": ids["<|endoftext|>"],
        },
        vision_config={
            "depth": 1,
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_heads": 2,
            "out_hidden_size": 64,
            "num_position_embeddings": 64,
            "deepstack_visual_indexes": [0],
        },
        image_token_id=ids["<|image_pad|>"],
        video_token_id=ids["<|video_pad|>"],
        vision_start_token_id=ids["<|vision_start|>"],
        vision_end_token_id=ids["<|vision_end|>"],
        tie_word_embeddings=True,
    )
    torch.manual_seed(0)
    model = Qwen3VLForConditionalGeneration(config)
    model.generation_config.eos_token_id = ids["<|im_end|>"]
    model.generation_config.pad_token_id = ids["<|endoftext|>"]
    model.save_pretrained(folder)
    return folder


def overfit(folder: Path, lessons: Sequence[tuple[Prompt, str]], *, steps: int = 120) -> float:
    """Train the model in a folder to give each prompt its answer; gives the last loss."""
    import torch
    from transformers import AutoModelForImageTextToText, AutoProcessor

    processor = AutoProcessor.from_pretrained(folder)
    model: Any = AutoModelForImageTextToText.from_pretrained(folder, dtype="float32").train()
    batches = [_lesson(processor, prompt, answer) for prompt, answer in lessons]
    optimizer = torch.optim.AdamW(model.parameters(), lr=5e-3)
    loss = 1.0
    for _ in range(steps):
        optimizer.zero_grad()
        total = sum(model(**batch).loss for batch in batches) / len(batches)
        total.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        loss = float(total.detach())
        if loss < 2e-3:
            break
    model.save_pretrained(folder)
    return loss


def _lesson(processor: Any, prompt: Prompt, answer: str) -> dict[str, Any]:
    from jiti.annotate.vlm.inprocess import to_inputs

    inputs = to_inputs(processor, prompt)
    asked = inputs["input_ids"].shape[1]
    ids = processor.tokenizer(answer + "<|im_end|>", return_tensors="pt")["input_ids"]
    for key, value in (("input_ids", ids), ("attention_mask", ids * 0 + 1)):
        inputs[key] = _joined(inputs[key], value)
    if "mm_token_type_ids" in inputs:
        inputs["mm_token_type_ids"] = _joined(inputs["mm_token_type_ids"], ids * 0)
    labels = inputs["input_ids"].clone()
    labels[:, :asked] = -100
    return {**inputs, "labels": labels}


def _joined(one: Any, other: Any) -> Any:
    import torch

    return torch.cat([one, other.to(one.dtype)], dim=1)


def _processor() -> Any:
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers
    from transformers import PreTrainedTokenizerFast, Qwen2VLImageProcessor, Qwen3VLProcessor, Qwen3VLVideoProcessor

    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    words = json.dumps({"segments": [], "evidence": "", "start_s": 0, "end_s": 1, "rationale": "", "verdict": ""})
    trainer = trainers.BpeTrainer(
        vocab_size=1200,
        special_tokens=list(SPECIAL),
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    texts = (Path(__file__).parents[2] / "jiti" / "annotate" / "vlm").glob("prompts.py")
    tokenizer.train_from_iterator([words * 9, *(path.read_text() for path in texts)], trainer)
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        eos_token="<|im_end|>",
        pad_token="<|endoftext|>",
        extra_special_tokens={
            "image_token": "<|image_pad|>",
            "video_token": "<|video_pad|>",
            "vision_bos_token": "<|vision_start|>",
            "vision_eos_token": "<|vision_end|>",
        },
    )
    size = {"shortest_edge": SIDE * SIDE, "longest_edge": SIDE * SIDE}
    images = Qwen2VLImageProcessor(patch_size=16, merge_size=2, temporal_patch_size=2, size=size)
    videos = Qwen3VLVideoProcessor(patch_size=16, merge_size=2, temporal_patch_size=2)
    return Qwen3VLProcessor(images, fast, videos, chat_template=CHAT_TEMPLATE)
