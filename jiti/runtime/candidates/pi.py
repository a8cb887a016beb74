"""Candidates of pi0 and pi0.5: pictures and instruction go through PaliGemma once for all of them.

An action of theirs looks at all actions of its chunk, so chunks are computed whole. pi0's state is a token beside the
actions; pi0.5 has it among the words.
"""

from dataclasses import dataclass
from importlib.metadata import version
from inspect import signature
from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened
from lerobot.policies.common.flow_matching import euler_integrate  # noqa: TID253
from lerobot.policies.common.vla_utils import make_att_2d_masks, prepare_attention_masks_4d  # noqa: TID253
from torch import Tensor  # noqa: TID253

from jiti.errors import UsageError


@dataclass(frozen=True, slots=True)
class Prefix:
    """What PaliGemma made of one observation."""

    valid: Tensor
    """(1, L): which tokens are no padding."""
    cache: Any
    """Keys and values of all layers."""
    state: Tensor | None
    """(1, S), of pi0."""


class PiSource:
    """The two halves of lerobot's `sample_actions`, with its own `denoise_step`."""

    history = 1

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self._model = policy.model
        self.chunk: int = policy.config.chunk_size
        self.noise_shape = (self.chunk, policy.config.max_action_dim)

    def look(self, prepared: list[dict[str, Any]]) -> Prefix:
        policy, model, seen = self._policy, self._model, prepared[-1]
        pictures, masks = policy._preprocess_images(seen)
        words, said = seen["observation.language.tokens"], seen["observation.language.attention_mask"]
        embedded, valid, ahead = model.embed_prefix(pictures, masks, words, said)
        model.paligemma_with_expert.paligemma.model.language_model.config._attn_implementation = "eager"
        _, cache = model.paligemma_with_expert.forward(
            attention_mask=prepare_attention_masks_4d(make_att_2d_masks(valid, ahead)),
            position_ids=torch.cumsum(valid, dim=1) - 1,
            past_key_values=None,
            inputs_embeds=[embedded, None],
            use_cache=True,
        )
        return Prefix(valid, cache, policy.prepare_state(seen) if policy.config.type == "pi0" else None)

    def draw(self, looked: Prefix, noise: Tensor, actions: int) -> Tensor:
        n = len(noise)
        shared: dict[str, Any] = {
            "prefix_pad_masks": looked.valid.expand(n, -1),
            "past_key_values": _repeated(looked.cache, n),
        }
        if looked.state is not None:
            shared["state"] = looked.state.expand(n, -1)
        chunks = euler_integrate(
            lambda chunks, time: self._model.denoise_step(x_t=chunks, timestep=time, **shared),
            noise,
            self._policy.config.num_inference_steps,
        )
        return chunks[..., : self._policy.config.output_features["action"].shape[0]]


def _repeated(cache: Any, n: int) -> Any:
    """A cache of one observation, seen as one of n; nothing is copied before `denoise_step` does."""
    from transformers import DynamicCache

    return DynamicCache(
        tuple((keys.expand(n, -1, -1, -1), values.expand(n, -1, -1, -1), window) for keys, values, window in cache)
    )


def open_source(policy: Any) -> PiSource:
    """Raises UsageError with a transformers that lerobot's pi0 and pi0.5 do not run with."""
    from lerobot.policies import pi_gemma

    # lerobot 0.6.1 passes what later versions no longer take.
    if "cache_position" not in signature(pi_gemma.create_causal_mask).parameters:
        raise UsageError(
            f"lerobot {version('lerobot')} does not run {policy.config.type} with transformers "
            f"{version('transformers')}. It asks for one below 5.6: pip install 'lerobot[pi]'."
        )
    return PiSource(policy)
