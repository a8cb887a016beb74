"""A base policy opened to act: its weights, frozen, and both of lerobot's pipelines of its checkpoint."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.critic.features.opened_policy import checkpoint_folder
from jiti.errors import UsageError
from jiti.runtime.candidates.observation import PICTURES
from jiti.runtime.candidates.source import KINDS

if TYPE_CHECKING:
    import torch
    from lerobot.policies.pretrained import PreTrainedPolicy


@dataclass(eq=False, slots=True)
class OpenedBase:
    """A policy with what stands before and behind it."""

    policy: "PreTrainedPolicy"
    preprocess: Any
    """Names as the policy's, batch dimension, normalization, tokens, device."""
    postprocess: Any
    """Chunks in the robot's units, on the CPU."""
    folder: Path
    """The checkpoint."""
    prepared_for: Any = None
    """Whose observation was preprocessed last: postprocessing may add to it, where actions are relative."""

    @property
    def config(self) -> Any:
        return self.policy.config

    def in_units(self, chunks: "torch.Tensor") -> np.ndarray:
        """The policy's chunks (n, K, A) in the robot's units, float32, for the observation that was prepared last."""
        import torch

        if self.config.type == "groot":
            # It decodes chunk i relative to the state of observation i, and there is one observation.
            return torch.cat([self.postprocess(chunk.unsqueeze(0)) for chunk in chunks]).float().cpu().numpy()
        return self.postprocess(chunks).float().cpu().numpy()

    def renamed(self, batch: Mapping[str, Any]) -> dict[str, Any]:
        """What the policy looks at, by its own names: pictures in their order where none has its name.

        Raises UsageError for what is missing or of another size; pictures may be missing that it was trained to do
        without (`empty_cameras`).
        """
        wanted = {key: tuple(f.shape) for key, f in (self.config.input_features or {}).items()}
        pictures = [key for key in wanted if key in self.config.image_features]
        there = [key for key in batch if key.startswith(PICTURES)]
        named = {key: key for key in pictures if key in batch} or dict(zip(pictures, there, strict=False))
        if pictures and not named:
            raise UsageError(f"{self.folder} needs pictures ({', '.join(pictures)}), and there are none.")
        lacking = [key for key in pictures if key not in named]
        if len(lacking) > getattr(self.config, "empty_cameras", 0):
            raise UsageError(
                f"{self.folder} was trained with {', '.join(lacking)}, not among {', '.join(there)}. Give it the "
                "cameras that it was trained with: --cameras in simulation, the robot's own on an arm."
            )
        for key in wanted:
            if key in pictures or not key.startswith("observation."):
                continue
            shape = tuple(batch[key].shape[1:]) if key in batch else None
            if shape != wanted[key]:
                have = f"of {shape}" if shape else f"not among {', '.join(sorted(batch))}"
                raise UsageError(
                    f"{self.folder} was trained with {key} of shape {wanted[key]}, and here it is {have}. "
                    "Use the robot and scene that it was trained on."
                )
            named[key] = key
        return {own: batch[key] for own, key in named.items()} | {"task": batch["task"]}


def open_base(source: str | Path, device: str) -> OpenedBase:
    """The policy of a checkpoint's folder, the newest of a training run's folder, or of a Hub id.

    Raises UsageError for what is no checkpoint, cannot be opened here, or does not draw its chunks from noise.
    """
    import torch
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    import jiti.policies

    jiti.policies.register()
    folder = checkpoint_folder(str(source))
    try:
        config = PreTrainedConfig.from_pretrained(folder)
    except (ValueError, OSError) as error:
        raise UsageError(f"{folder} holds no policy that lerobot opens: {error}") from error
    if config.type not in KINDS:
        raise UsageError(
            f"{source} is a policy of type {config.type}, which is not known to draw different chunks from different "
            f"noise, so there are no candidates to choose from. Pass a policy of type {', '.join(KINDS)}."
        )
    config.device = device
    if hasattr(config, "load_vlm_weights"):
        # The checkpoint has all weights.
        config.load_vlm_weights = False  # pyright: ignore[reportAttributeAccessIssue]
    try:
        # Weights are drawn before they are loaded; the caller's random numbers are not to change by that.
        with torch.random.fork_rng():
            policy = get_policy_class(config.type).from_pretrained(folder, config=config)
        preprocess, postprocess = make_pre_post_processors(
            config, str(folder), preprocessor_overrides={"device_processor": {"device": device}}
        )
    except (OSError, ImportError, ValueError) as error:
        raise UsageError(f"{source}: lerobot cannot open this policy here: {error}") from error
    policy.to(device).eval().requires_grad_(False)
    return OpenedBase(policy, preprocess, postprocess, folder)
