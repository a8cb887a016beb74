"""Features from SmolVLA's prefix: what its vision-language model makes of pictures, instruction and state.

The action expert of SmolVLA attends to the prefix, so it holds what the policy knows when it draws a chunk; noise has
no part in it. Supplement C.4 trains the critic on these features, projected to the critic's size.

`smolvla:PATH_OR_HUB_ID` gives one token for each camera (the mean of its picture's tokens), one for the instruction
and one for the state; `smolvla:PATH_OR_HUB_ID#all` keeps all tokens, hundreds a frame. The paper does not say which it
uses: the means are our choice, as all tokens of 60,000 frames take 20 GB.
"""

import hashlib
from typing import TYPE_CHECKING, Any

from jiti.critic.features.base import Batch, Shapes
from jiti.critic.features.opened_policy import OpenedPolicy, open_policy
from jiti.errors import UsageError

if TYPE_CHECKING:
    import torch

VERSION = 1
"""Of this code: raise it when features change."""
_OPTIONS = ("", "all")


class SmolVLAFeatures:
    """Hidden states of the last layer that the policy uses, after its norm."""

    def __init__(self, name: str, opened: OpenedPolicy, option: str) -> None:
        import torch

        self.name = name
        self.needs = opened.needs
        self._opened = opened
        self._policy: Any = opened.policy
        self._model = self._policy.model
        # Padding to a fixed length would only be taken away again.
        self._model.prefix_length = -1
        self._all = option == "all"
        config = self._policy.config
        width, height = config.resize_imgs_with_padding
        with torch.inference_mode():
            picture = torch.zeros(1, 3, height, width, device=config.device)
            self._picture_tokens: int = self._model.vlm_with_expert.embed_image(picture).shape[1]
        if self._model.add_image_special_tokens:
            self._picture_tokens += len(self._model.global_image_start_token) + len(self._model.image_end_token)
        self._words: int = config.tokenizer_max_length
        self._pictures = len(opened.renamed) + min(
            config.empty_cameras, len(config.image_features) - len(opened.renamed)
        )
        self.size: int = self._model.vlm_with_expert.config.text_config.hidden_size
        self.tokens = self._pictures * self._picture_tokens + self._words + 1 if self._all else self._pictures + 2
        about = f"smolvla {VERSION} {option} {opened.fingerprint} {sorted(opened.renamed.items())}"
        self.fingerprint = hashlib.sha256(about.encode()).hexdigest()

    def features(self, batch: Batch) -> "torch.Tensor":
        """(B, tokens, size) float32."""
        import torch
        from lerobot.policies.common.vla_utils import make_att_2d_masks

        with torch.inference_mode():
            seen = self._opened.prepared(batch)
            pictures, masks = self._policy.prepare_images(seen)
            words, said = seen["observation.language.tokens"], seen["observation.language.attention_mask"]
            embedded, valid, ahead = self._model.embed_prefix(
                pictures, masks, words, said, state=self._policy.prepare_state(seen)
            )
            # With a cache, as the policy runs its prefix: without one, layers ask for the expert's part too.
            (hidden, _), _ = self._model.vlm_with_expert.forward(
                attention_mask=make_att_2d_masks(valid, ahead),
                position_ids=torch.cumsum(valid, dim=1) - 1,
                past_key_values=None,
                inputs_embeds=[embedded, None],
                use_cache=True,
            )
            hidden = hidden.float() * valid.unsqueeze(-1)
            lengths = [self._picture_tokens] * self._pictures + [words.shape[1], 1]
            parts = list(zip(hidden.split(lengths, dim=1), valid.split(lengths, dim=1), strict=True))
            if self._all:
                spare = hidden.new_zeros(len(hidden), self._words - words.shape[1], self.size)
                *shown, told, state = (part for part, _ in parts)
                return torch.cat([*shown, told, spare, state], dim=1)
            return torch.stack([p.sum(1) / v.sum(1, keepdim=True).clamp_min(1) for p, v in parts], dim=1)


def open_extractor(argument: str, shapes: Shapes, device: str) -> SmolVLAFeatures:
    """`argument` is a checkpoint's folder or Hub id, and may end in `#all`. Raises UsageError."""
    source, _, option = argument.partition("#")
    if option not in _OPTIONS:
        raise UsageError(f"--features smolvla:{argument}: after # there may be `all`, for all tokens of the prefix.")
    return SmolVLAFeatures(f"smolvla:{argument}", open_policy(source, shapes, device, kind="smolvla"), option)
