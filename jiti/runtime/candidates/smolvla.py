"""Candidates of SmolVLA: pictures, instruction and state go through its vision-language model once for all of them.

Its action expert reads the keys and values of that prefix, and an action looks at the actions before it only
(`att_masks` of lerobot's `embed_suffix` are all 1). So the actions behind those that are wanted are not computed, and
candidates stand one behind the other in one sequence that is masked so that none sees another: keys and values of the
prefix are neither copied nor projected again for each.
"""

from dataclasses import dataclass
from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened
from lerobot.policies.common.flow_matching import euler_integrate  # noqa: TID253
from lerobot.policies.common.vla_utils import make_att_2d_masks  # noqa: TID253
from torch import Tensor  # noqa: TID253

_TOKENS_AT_ONCE = 512
"""Actions of all candidates in one sequence. Our choice: attention among them grows with its square."""


@dataclass(frozen=True, slots=True)
class Prefix:
    """What SmolVLA's vision-language model made of one observation."""

    hidden: Tensor
    """(1, L, D) after its last norm."""
    valid: Tensor
    """(1, L): which tokens are no padding."""
    cache: Any
    """Keys and values of all layers."""
    pictures: int
    """How many pictures its tokens begin with, the same number for each."""
    words: int
    """Tokens of the instruction, which stand before the state's one token."""


class SmolVLASource:
    """The two halves of lerobot's `VLAFlowMatching.sample_actions`, with its own layers."""

    history = 1
    features_kind = "smolvla"

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self._model = policy.model
        # Padding of the prefix to a fixed length would only be masked again.
        self._model.prefix_length = -1
        config = policy.config
        self.chunk: int = config.chunk_size
        self.noise_shape = (self.chunk, config.max_action_dim)

    def look(self, prepared: list[dict[str, Any]]) -> Prefix:
        policy, model = self._policy, self._model
        # Aloha's state is changed in place.
        seen = policy._prepare_batch({k: v.clone() if isinstance(v, Tensor) else v for k, v in prepared[-1].items()})
        pictures, masks = policy.prepare_images(seen)
        words, said = seen["observation.language.tokens"], seen["observation.language.attention_mask"]
        embedded, valid, ahead = model.embed_prefix(pictures, masks, words, said, state=policy.prepare_state(seen))
        (hidden, _), cache = model.vlm_with_expert.forward(
            attention_mask=make_att_2d_masks(valid, ahead),
            position_ids=torch.cumsum(valid, dim=1) - 1,
            past_key_values=None,
            inputs_embeds=[embedded, None],
            use_cache=True,
        )
        return Prefix(hidden, valid, cache, len(pictures), words.shape[1])

    def draw(self, looked: Prefix, noise: Tensor, actions: int) -> Tensor:
        config = self._policy.config
        groups = noise[:, :actions].split(max(1, _TOKENS_AT_ONCE // actions))
        chunks = torch.cat([self._integrate(looked, group) for group in groups])
        chunks = chunks[..., : config.action_feature.shape[0]]
        return self._policy._pi_aloha_encode_actions(chunks) if config.adapt_to_pi_aloha else chunks

    def features(self, looked: Prefix, option: str) -> Tensor:
        """Tokens (1, T, D) float32 as `jiti.critic.features.smolvla` makes them."""
        side = (looked.valid.shape[1] - looked.words - 1) // looked.pictures
        lengths = [side] * looked.pictures + [looked.words, 1]
        hidden = looked.hidden.float() * looked.valid.unsqueeze(-1)
        parts = list(zip(hidden.split(lengths, dim=1), looked.valid.split(lengths, dim=1), strict=True))
        if option == "all":
            *shown, state = (part for part, _ in parts)
            spare = hidden.new_zeros(1, self._policy.config.tokenizer_max_length - looked.words, hidden.shape[-1])
            return torch.cat([*shown, spare, state], dim=1)
        return torch.stack([p.sum(1) / v.sum(1, keepdim=True).clamp_min(1) for p, v in parts], dim=1)

    def _integrate(self, looked: Prefix, noise: Tensor) -> Tensor:
        """(n, k, A') -> (n, k, A'), k being the first actions of a chunk."""
        n, k, _ = noise.shape
        seen = looked.valid.unsqueeze(1).expand(1, n * k, -1)
        own = torch.ones(k, k, dtype=torch.bool, device=noise.device).tril()
        mask = torch.cat([seen, torch.block_diag(*[own] * n).bool().unsqueeze(0)], dim=2)
        places = (looked.valid.sum() + torch.arange(k, device=noise.device)).repeat(n).unsqueeze(0)

        kept = [(layer.keys, layer.values) for layer in looked.cache.layers]

        def velocity(chunks: Tensor, time: Tensor) -> Tensor:
            embedded, _, _ = self._model.embed_suffix(chunks, time)
            (_, out), _ = self._model.vlm_with_expert.forward(
                attention_mask=mask,
                position_ids=places,
                past_key_values=looked.cache,
                inputs_embeds=[None, embedded.reshape(1, n * k, -1)],
                use_cache=True,
            )
            # Layers with self-attention put what they got behind the prefix. lerobot 0.6.1 takes it off by `crop` with
            # the length that is left, which transformers 5.24 refuses.
            for layer, (keys, values) in zip(looked.cache.layers, kept, strict=True):
                layer.keys, layer.values = keys, values
            return self._model.action_out_proj(out.float()).reshape(n, k, -1)

        return euler_integrate(velocity, noise, self._policy.config.num_steps)


def open_source(policy: Any) -> SmolVLASource:
    return SmolVLASource(policy)
