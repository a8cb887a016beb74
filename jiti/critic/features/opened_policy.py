"""A policy of lerobot opened to look at observations: from a folder or the Hub, frozen, with its own preprocessing."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jiti.critic.features.base import Batch, Shapes
from jiti.errors import UsageError

if TYPE_CHECKING:
    from lerobot.policies.pretrained import PreTrainedPolicy

PICTURES = "observation.images."
_LAST = Path("checkpoints", "last", "pretrained_model")
"""Where a run of `lerobot-train` has its newest checkpoint."""
_WANTED = ("*.json", "*.safetensors")
"""Files of a checkpoint that are fetched from the Hub."""


@dataclass(frozen=True)
class OpenedPolicy:
    """A policy, and how a dataset's observations are handed to it."""

    policy: "PreTrainedPolicy"
    preprocess: Any
    """lerobot's pipeline of the checkpoint: normalization, tokens, device, padding."""
    renamed: Mapping[str, str]
    """The policy's names of pictures by the dataset's."""
    needs: tuple[str, ...]
    """The dataset's keys that are handed over."""
    fingerprint: str
    """Hex digest of the checkpoint's files."""

    def prepared(self, batch: Batch) -> dict[str, Any]:
        """A batch as the policy takes it. Raises UsageError where a key is missing."""
        missing = [key for key in self.needs if key not in batch]
        if missing:
            raise UsageError(f"the batch lacks {', '.join(missing)}; it has: {', '.join(sorted(batch))}.")
        return self.preprocess({self.renamed.get(key, key): batch[key] for key in self.needs})


def open_policy(argument: str, shapes: Shapes, device: str, *, kind: str | None = None) -> OpenedPolicy:
    """The policy in a checkpoint's folder, the newest of a training run's folder, or of a Hub id.

    Raises UsageError for what is no checkpoint, is of another kind than `kind`, or was trained on other observations
    than `shapes` says there are.
    """
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    import jiti.policies

    jiti.policies.register()
    folder = checkpoint_folder(argument)
    try:
        config = PreTrainedConfig.from_pretrained(folder)
    except (ValueError, OSError) as error:
        raise UsageError(f"{folder} holds no policy that lerobot opens: {error}") from error
    if kind is not None and config.type != kind:
        raise UsageError(
            f"{argument} is a policy of type {config.type}, not {kind}. Pass --features policy:{argument}#MODULE, or "
            f"--features {config.type}:{argument} where there is such a kind."
        )
    config.device = device
    if hasattr(config, "load_vlm_weights"):
        # The checkpoint has all weights.
        config.load_vlm_weights = False  # pyright: ignore[reportAttributeAccessIssue]
    renamed = _pictures(argument, config.image_features, shapes)
    numbers = _numbers(argument, config.input_features or {}, shapes)
    try:
        policy = get_policy_class(config.type).from_pretrained(folder, config=config)
        preprocess, _ = make_pre_post_processors(
            config, str(folder), preprocessor_overrides={"device_processor": {"device": device}}
        )
    except (OSError, ImportError, ValueError) as error:
        raise UsageError(f"{argument}: lerobot cannot open this policy here: {error}") from error
    policy.eval().requires_grad_(False)
    return OpenedPolicy(policy, preprocess, renamed, (*numbers, *renamed, "task"), _digest(folder))


def checkpoint_folder(argument: str) -> Path:
    """The folder with `config.json` and weights; a Hub id's is fetched. Raises UsageError."""
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError

    path = Path(argument).expanduser()
    if path.is_dir():
        for folder in (path, path / _LAST):
            if (folder / "config.json").is_file():
                return folder
        raise UsageError(f"{path} has neither config.json nor {_LAST}. Pass a checkpoint of lerobot-train.")
    # In a folder that is here it is a path with a mistake in it, which is not to be asked for on the Hub.
    if path.is_absolute() or len(path.parts) != 2 or path.parent.is_dir():
        raise UsageError(f"{argument}: there is no such folder, and a Hub id has the form USER/NAME. Check the path.")
    try:
        return Path(snapshot_download(argument, allow_patterns=list(_WANTED)))
    except (HfHubHTTPError, HFValidationError, LocalEntryNotFoundError, OSError) as error:
        told = " ".join(str(error).split())
        raise UsageError(f"{argument} is no folder here, and the Hub does not give it: {told}") from error


def _pictures(argument: str, seen: Mapping[str, Any], shapes: Shapes) -> dict[str, str]:
    """The policy's pictures by those of the dataset: by name, else in their order."""
    there = [key for key in shapes if key.startswith(PICTURES)]
    if not seen:
        return {}
    if not there:
        raise UsageError(f"{argument} needs pictures ({', '.join(seen)}), and there are none. Pass --features state.")
    same = {key: key for key in seen if key in shapes}
    return same or dict(zip(there, seen, strict=False))


def _numbers(argument: str, seen: Mapping[str, Any], shapes: Shapes) -> list[str]:
    """Keys of vectors that the policy takes. Raises UsageError where they are missing or of another size."""
    keys = [key for key in seen if key.startswith("observation.") and PICTURES not in key]
    for key in keys:
        if key not in shapes:
            raise UsageError(f"{argument} needs {key}; there are: {', '.join(sorted(shapes))}.")
        if tuple(shapes[key]) != tuple(seen[key].shape):
            raise UsageError(
                f"{argument} was trained with {key} of {seen[key].shape[0]} numbers, and here it has "
                f"{shapes[key][0]}. Fine-tune it on this dataset first: `lerobot-train`, see docs/policies.md."
            )
    return keys


def _digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(p for pattern in _WANTED for p in folder.glob(pattern)):
        if path.name == "train_config.json":
            continue
        digest.update(f"{path.name}\0".encode())
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
