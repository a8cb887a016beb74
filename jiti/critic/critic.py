"""A critic as one thing: what observations become, which range actions have, Q and the actor; saved and loaded.

A folder with `config.json` and `model.safetensors`; loadable by path or Hub id. No pickles.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  imported by training and evaluation only, which need torch
from torch import Tensor, nn  # noqa: TID253

from jiti.critic.backbone import Backbone, describe_backbone, empty_backbone, load_backbone
from jiti.critic.chunks import ActionRange
from jiti.critic.networks import Actor, QEnsemble, Transformer
from jiti.critic.settings import NetworkSettings
from jiti.critic.settings_file import settings_from
from jiti.durable import make_folder, replacing, write_atomic
from jiti.errors import SourceError

VERSION = 1


@dataclass(frozen=True)
class Sizes:
    """What features and actions have to be like for a critic to take them."""

    features: int
    """F, numbers of a feature token."""
    tokens: int
    """T, feature tokens of a frame."""
    action: int
    """A, numbers of an action."""


@dataclass
class Critic:
    """Q and the actor with all that is needed to ask them about observations and actions as a robot has them."""

    q: QEnsemble
    actor: Actor
    sizes: Sizes
    network: NetworkSettings
    limits: ActionRange
    config: dict[str, Any]
    """What `config.json` says beside: extractor, settings, dataset, versions."""

    @property
    def chunk(self) -> int:
        """K."""
        return self.network.chunk

    @torch.no_grad()
    def values(self, features: Tensor, chunks: np.ndarray, mask: np.ndarray | None = None) -> Tensor:
        """Q of each member (E, B, N) of features (B, T, F) and chunks (B, N, K, A) in the recording's units.

        `mask` (B, K) tells which actions there are; all, by default. Raises SourceError for other sizes.
        """
        wanted = (self.chunk, self.sizes.action), (self.sizes.tokens, self.sizes.features)
        if chunks.shape[2:] != wanted[0] or tuple(features.shape[1:]) != wanted[1]:
            raise SourceError(
                f"this critic values chunks of {wanted[0]} actions x numbers with features of {wanted[1]} tokens x "
                f"numbers; it was given {tuple(chunks.shape[2:])} and {tuple(features.shape[1:])}. Use the features "
                f"and robot that it was trained with: {self.config.get('extractor', {}).get('name')}."
            )
        device = self.q.scale.device
        there = np.ones((len(chunks), self.chunk), bool) if mask is None else mask
        unit = torch.from_numpy(self.limits.to_unit(chunks)).to(device)
        return self.q(features.to(device), unit, torch.from_numpy(there).to(device))


def make_critic(network: NetworkSettings, sizes: Sizes, limits: ActionRange, config: dict[str, Any]) -> Critic:
    """A critic with new weights; a backbone's are pretrained."""
    trunk: nn.Module
    if network.backbone:
        trunk = load_backbone(
            network.backbone,
            sizes.features,
            sizes.action,
            trust_remote_code=network.trust_remote_code,
            gradient_checkpointing=network.gradient_checkpointing,
        )
    else:
        trunk = _transformer(network, sizes)
    return _of_trunk(trunk, network, sizes, limits, config)


def save_critic(critic: Critic, folder: Path, more: dict[str, Any]) -> None:
    """Write `config.json` and `model.safetensors`; `more` is added to the config. Raises SaveFailed."""
    make_folder(folder)
    weights = {f"q.{k}": v for k, v in critic.q.state_dict().items()}
    weights |= {f"actor.{k}": v for k, v in critic.actor.state_dict().items()}
    save_tensors(folder / "model.safetensors", weights)
    trunk = critic.q.trunk
    config = {
        **critic.config,
        **more,
        "version": VERSION,
        "sizes": asdict(critic.sizes),
        "network": asdict(critic.network),
        "backbone": describe_backbone(trunk) if isinstance(trunk, Backbone) else None,
        "action_low": critic.limits.low.tolist(),
        "action_high": critic.limits.high.tolist(),
    }
    write_atomic(folder / "config.json", json.dumps(config, indent=2, sort_keys=True).encode())


def load_critic(source: str | Path, *, device: str = "cpu") -> Critic:
    """The critic of a folder or Hub id. Raises SourceError for what is missing, damaged or of other sizes."""
    folder = _folder(source)
    try:
        config = json.loads((folder / "config.json").read_bytes())
        if not {"version", "sizes", "network"} & config.keys():
            raise SourceError(
                f"{folder} is no critic: its config.json is of something else. Train one with "
                "`jiti train-critic DATASET --out RUN`."
            )
        if config["version"] != VERSION:
            raise SourceError(
                f"{folder}: a critic of version {config['version']}; this jiti reads {VERSION}. Update jiti."
            )
        network = settings_from({"network": config["network"]}).network
        sizes = Sizes(**config["sizes"])
        limits = saved_limits(config)
        described = config["backbone"]
    except OSError as error:
        raise SourceError(
            f"{folder} is no critic: {error.filename} cannot be read ({error.strerror}). Train one with "
            "`jiti train-critic DATASET --out RUN`."
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SourceError(f"{folder / 'config.json'} is damaged: {error!r}. Train again, or copy it again.") from error
    trunk = empty_backbone(described, sizes.features, sizes.action) if described else _transformer(network, sizes)
    critic = _of_trunk(trunk, network, sizes, limits, config)
    weights = load_tensors(folder / "model.safetensors")
    for name, module in (("q", critic.q), ("actor", critic.actor)):
        fill(module, {k.removeprefix(f"{name}."): v for k, v in weights.items() if k.startswith(f"{name}.")}, folder)
        module.to(device).eval()
    return critic


def saved_limits(config: Mapping[str, Any]) -> ActionRange:
    """The range of actions that `config.json` names."""
    return ActionRange(*(np.array(config[name], np.float32) for name in ("action_low", "action_high")))


def fill(module: nn.Module, weights: dict[str, Tensor], where: Path) -> None:
    """Put weights into a module. Raises SourceError, which names the first that is missing or of another size."""
    own = module.state_dict()
    for name in (*own, *weights):
        have, want = weights.get(name), own.get(name)
        if have is None or want is None or have.shape != want.shape:
            said = [("nothing" if x is None else f"size {tuple(x.shape)}") for x in (have, want)]
            raise SourceError(
                f"{where} does not fit: {name} has {said[0]} there, and {said[1]} with these settings and this data. "
                "Train into another --out, or with the network, features and dataset that it was made with."
            )
    module.load_state_dict(weights)


def save_tensors(path: Path, tensors: dict[str, Tensor]) -> None:
    """Write tensors as safetensors, atomically."""
    from safetensors.torch import save_file

    with replacing(path) as temporary:
        save_file({name: tensor.detach().contiguous().cpu().clone() for name, tensor in tensors.items()}, temporary)


def load_tensors(path: Path) -> dict[str, Tensor]:
    """Tensors of a safetensors file. Raises SourceError."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise SourceError(f"{path} cannot be read: {error}. Copy it again, or train again.") from error


def _folder(source: str | Path) -> Path:
    folder = Path(source)
    local = folder.exists() or folder.parent.is_dir() or str(source).startswith((".", "/"))
    if local or str(source).count("/") != 1:
        return folder
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(str(source), allow_patterns=["config.json", "model.safetensors"]))
    except Exception as error:
        raise SourceError(f"{source} is no folder here, and the Hub did not give it: {str(error)[:200]}.") from error


def _transformer(network: NetworkSettings, sizes: Sizes) -> Transformer:
    return Transformer(
        features=sizes.features * (1 + 2 * network.octaves),
        tokens=sizes.tokens,
        action=sizes.action,
        chunk=network.chunk,
        members=network.ensemble,
        width=network.width,
        depth=network.depth,
        heads=network.heads,
    )


def _of_trunk(
    trunk: Any, network: NetworkSettings, sizes: Sizes, limits: ActionRange, config: dict[str, Any]
) -> Critic:
    q = QEnsemble(trunk, sizes.features, trunk.width, network.ensemble, network.octaves)
    actor = Actor(sizes.features, sizes.action, network.chunk, network.actor_width)
    return Critic(q, actor, sizes, network, limits, config)
