"""A Hugging Face causal or vision-language model as Q's trunk, fed through one linear projection, as in the paper.

Of a vision-language model the language part is used: features stand where its embedded tokens would. The paper takes
SmolVLM2-256M-Video-Instruct for SmolVLA's features and Eagle2-1B for GR00T-N1.5's (supplement C.4).
"""

from typing import Any

import torch  # noqa: TID253  imported by training and evaluation only, which need torch
from torch import Tensor, nn  # noqa: TID253

from jiti.errors import UsageError


class Backbone(nn.Module):
    """Feature tokens, action tokens and a read-out token through a language model; the read-out's last state is given.

    Members of the ensemble share it, and differ in their heads.
    """

    def __init__(self, model: nn.Module, width: int, features: int, action: int) -> None:
        super().__init__()
        self.width = width
        self.model = model
        self.project = nn.Linear(features, width)
        """The one projection from the policy's feature size to the backbone's hidden size, C.4."""
        self.action_in = nn.Linear(action, width)
        """Our choice: the paper does not say how actions enter; one linear layer, like features."""
        self.readout = nn.Parameter(torch.randn(width) * 0.02)

    def forward(self, features: Tensor, there: Tensor, chunks: Tensor, mask: Tensor) -> Tensor:
        """(B, T, F), (B, T), (B, N, K, A), (B, K) -> (B * N, W)."""
        b, n = chunks.shape[:2]
        seen = self.project(features).repeat_interleave(n, 0)
        acts = self.action_in(chunks.flatten(0, 1))
        x = torch.cat([seen, acts, self.readout.expand(b * n, 1, -1).to(acts.dtype)], 1)
        keys = torch.cat([there, mask, mask.new_ones(b, 1)], 1).repeat_interleave(n, 0)
        # Places count what is there, so that padding before or between tokens moves nothing.
        places = (keys.long().cumsum(1) - 1).clamp(min=0)
        model: Any = self.model
        out = model(inputs_embeds=x, attention_mask=keys.long(), position_ids=places, use_cache=False)
        return out.last_hidden_state[:, -1]


def load_backbone(
    name: str, features: int, action: int, *, trust_remote_code: bool = False, gradient_checkpointing: bool = True
) -> Backbone:
    """The backbone of a folder or Hub id, with its pretrained weights. Raises UsageError when it cannot be loaded."""
    import transformers

    transformers.utils.logging.disable_progress_bar()
    transformers.utils.logging.set_verbosity_error()
    try:
        whole: Any = transformers.AutoModel.from_pretrained(
            name, dtype=torch.float32, use_safetensors=True, trust_remote_code=trust_remote_code
        )
    except (OSError, ValueError, KeyError, ImportError, AttributeError) as error:
        raise UsageError(
            f"network.backbone {name} cannot be loaded: {' '.join(str(error).split())[:300]}. Give a folder or Hub id "
            "of a model of transformers; one that brings its own code also needs network.trust_remote_code = true."
        ) from error
    return _fed_by_features(whole, name, features, action, gradient_checkpointing)


def empty_backbone(config: dict[str, Any], features: int, action: int) -> Backbone:
    """The backbone of a checkpoint, of `describe_backbone`, whose weights are loaded next."""
    import transformers

    kind = transformers.CONFIG_MAPPING[config["model_type"]]
    whole: Any = transformers.AutoModel.from_config(kind.from_dict(config))
    return _fed_by_features(whole, config["model_type"], features, action, False)


def describe_backbone(backbone: Backbone) -> dict[str, Any]:
    """What a checkpoint says of the language part, so that it is made again without the Hub."""
    model: Any = backbone.model
    return model.config.to_dict()


def _fed_by_features(whole: Any, name: str, features: int, action: int, gradient_checkpointing: bool) -> Backbone:
    decoder = whole.get_decoder() if hasattr(whole, "get_decoder") else whole
    embeddings = decoder.get_input_embeddings()
    if embeddings is None or not hasattr(decoder.config, "hidden_size"):
        raise UsageError(f"network.backbone {name} has no language model that takes embedded tokens. Take another.")
    width = decoder.config.hidden_size
    # Its table of words is never looked at: features come embedded. Only a row stays, which keeps checkpoints small.
    decoder.set_input_embeddings(nn.Embedding(1, width))
    decoder.config.vocab_size, decoder.config.pad_token_id = 1, None
    decoder.get_input_embeddings().requires_grad_(False)
    if gradient_checkpointing and decoder.supports_gradient_checkpointing:
        # transformers 5.24 has a new name for it, and 5.5 does not know that.
        enable = getattr(decoder, "activation_checkpointing_enable", decoder.gradient_checkpointing_enable)
        enable({"use_reentrant": False})
        # transformers loads in eval mode, and checkpoints in training mode only. Without dropout the two do the same.
        _leave_out_dropout(decoder)
        decoder.train()
    return Backbone(decoder, width, features, action)


def _leave_out_dropout(decoder: nn.Module) -> None:
    """So that values, and runs that go on, depend on nothing but weights and inputs.

    Layers have it as modules, as numbers that attention is called with (`attention_dropout`), or in their config.
    """
    for part in (*decoder.modules(), decoder.config):
        if isinstance(part, nn.Dropout):
            part.p = 0.0
        for name, value in vars(part).items():
            if isinstance(value, float) and "drop" in name:
                setattr(part, name, 0.0)
