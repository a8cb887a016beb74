"""Every constant of a critic's training: meaning, unit, source. Frozen records, checked when they are made.

"C.4" is the paper's supplement, which gives them for SmolVLA's features unless it says otherwise.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Literal

from jiti.errors import UsageError


@dataclass(frozen=True)
class DataSettings:
    """What is learned from."""

    features: str = "state"
    """Name of the feature extractor: `state`, `smolvla:PATH_OR_HUB_ID`, `groot:...`, `policy:...`."""
    gamma: float | None = None
    """Discount. Default: the dataset's own, 0.98 in C.4 (stated for GR00T-N1.5)."""
    decided_share: float = 0.0
    """Share of a batch that is taken from the frames whose chunks reach into a decided segment, the rest is from all
    frames. 0: every frame as often as another, as the paper seems to. Decided segments are a tenth of the frames."""
    rewards: Literal["segments", "success"] = "segments"
    """What r_t is: the labelled segments', or the paper's ablation, a sparse label of 1 at the last frame of an episode
    that succeeded. With it, the last frame is the only one that decides anything."""
    shuffle_labels: bool = False
    """Verdicts are dealt anew among the decided segments of each task: a control that must not learn to rank."""

    def __post_init__(self) -> None:
        _within("data.gamma", self.gamma, 0, 1)
        _within("data.decided_share", self.decided_share, 0, 1)
        _one_of("data.rewards", self.rewards, ("segments", "success"))


@dataclass(frozen=True)
class NetworkSettings:
    """What Q and the actor are made of."""

    chunk: int = 10
    """K, actions that are valued together. C.4."""
    ensemble: int = 2
    """E, members of which the least counts. Two, as in the code published with Cal-QL."""
    backbone: str = ""
    """Folder or Hub id of a causal or vision-language model as trunk. C.4: HuggingFaceTB/SmolVLM2-256M-Video-Instruct
    with SmolVLA's features, nvidia/Eagle2-1B with GR00T-N1.5's. Empty: the built-in transformer."""
    trust_remote_code: bool = False
    """Run code that comes with the backbone, which nvidia/Eagle2-1B needs."""
    gradient_checkpointing: bool = True
    """Of the backbone: less memory, a third more time. C.4."""
    octaves: int = 0
    """Octaves in which the built-in transformer also sees each normalized feature, as sine and cosine. Our choice: none
    for the features of a policy; for places, whose spread over all tasks is some decimetres, millimetres decide."""
    width: int = 64
    """Of the built-in transformer's tokens and of the value heads. Our choice: for two cores."""
    depth: int = 1
    """Blocks of the built-in transformer. Our choice: for two cores, where a second more than doubles the time."""
    heads: int = 4
    """Attention heads of the built-in transformer. Our choice."""
    actor_width: int = 256
    """Of the actor's two hidden layers. As in the code published with Cal-QL."""

    def __post_init__(self) -> None:
        for name in ("chunk", "ensemble", "width", "depth", "heads", "actor_width"):
            _within(f"network.{name}", getattr(self, name), 1, math.inf)
        _within("network.octaves", self.octaves, 0, 16)
        if self.octaves and self.backbone:
            raise UsageError("network.octaves is for the built-in transformer: leave it out with network.backbone.")
        if self.width % self.heads:
            raise UsageError(f"network.width is {self.width}; it must be a multiple of network.heads, {self.heads}.")


@dataclass(frozen=True)
class LossSettings:
    """Cal-QL (`jiti.critic.cal_ql`)."""

    td_offset: int = 10
    """n, frames whose rewards are summed before the target network's value counts. C.4."""
    alpha: float = 5.0
    """Weight of the conservative term, fixed. C.4."""
    lagrange: bool = False
    """Let a multiplier of alpha follow the target action gap. C.4 does not."""
    multiplier: float = 0.1
    """Where that multiplier starts. C.4, stated for GR00T-N1.5, where it is unused."""
    action_gap: float = 0.5
    """Target of the conservative term with `lagrange`. C.4."""
    variant: Literal["paper", "public"] = "paper"
    """How the conservative term is written: see `jiti.critic.cal_ql`."""
    calibrate: bool = True
    """Bound it by the Monte-Carlo return; without, it is CQL."""
    policy_chunks: int = 2
    """N, chunks that are drawn from the actor for it. Our choice: the published code's 10 cost four times as much."""
    random_chunks: int = 10
    """M, uniformly random chunks of `public`. As in the code published with Cal-QL."""
    backup: Literal["mean", "max"] = "mean"
    """Value of the next state: mean or best of chunks drawn there. Our choice: the published code takes the best."""
    backup_chunks: int = 1
    """Chunks that are drawn there. Our choice: as in soft actor-critic."""
    soft_update: float = 5e-3
    """Share by which the target network follows, a step. C.4."""
    temperature: float = 0.01
    """Weight of the actor's entropy at the start. Our choice: at the usual 1, and with C.4's learning rate, 70 numbers'
    entropy outweighs every value for all of the training."""
    target_entropy: float | None = None
    """Of the actor, in nats. Default: minus the numbers of a chunk, as in soft actor-critic."""

    def __post_init__(self) -> None:
        for name in ("td_offset", "policy_chunks", "random_chunks", "backup_chunks"):
            _within(f"loss.{name}", getattr(self, name), 1, math.inf)
        for name in ("alpha", "multiplier", "temperature"):
            _within(f"loss.{name}", getattr(self, name), 0, math.inf)
        _within("loss.soft_update", self.soft_update, 0, 1)
        _one_of("loss.variant", self.variant, ("paper", "public"))
        _one_of("loss.backup", self.backup, ("mean", "max"))


@dataclass(frozen=True)
class OptimizerSettings:
    """Adam with a rate for each part."""

    critic_lr: float = 1e-5
    """Of value heads, and of the built-in transformer. C.4 (LR_Q)."""
    actor_lr: float = 1e-5
    """C.4 (LR_pi); 1e-6 with GR00T-N1.5's features."""
    backbone_lr: float = 3e-6
    """Of a backbone and its projections. C.4 (LR_VLM)."""
    temperature_lr: float = 2e-5
    """C.4 (LR_tau)."""
    multiplier_lr: float = 1e-4
    """Of Lagrange's multiplier. C.4 (LR_alpha)."""
    clip: float = 0.5
    """Greatest norm of a gradient, of Q's and of the actor's. C.4, stated for GR00T-N1.5."""

    def __post_init__(self) -> None:
        for known in fields(self):
            _within(f"optimizer.{known.name}", getattr(self, known.name), 0, math.inf)


MOST_SEED = 2**32 - 1
"""Greatest seed: torch's generators take 64 bits, of which 32 number the step."""


@dataclass(frozen=True)
class RunSettings:
    """How long, how exactly, how often something is written."""

    steps: int = 20_000
    """Gradient steps. C.4."""
    batch: int = 32
    """Chunks a step, of all processes together. C.4."""
    seed: int = 0
    """Of weights, order and noise."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """bfloat16 as in C.4 where there is a GPU, float32 on CPUs, which are slower with it (auto)."""
    keep: Literal["target", "online"] = "target"
    """Which Q validation looks at and a run keeps: the target network, an average over the last 1 / `loss.soft_update`
    steps, or the one that steps change. Our choice: the average ranks better (docs/critic.md)."""
    device: str = "auto"
    """`cpu`, `cuda`, or the GPU where there is one."""
    log_every: int = 50
    """Steps between rows of metrics. Our choice."""
    check_every: int = 500
    """Steps between looks at the validation split and checkpoints. Our choice."""
    patience: int = 10
    """Looks after which training ends if none was better: a better ranking, or where that is unknown a lower L_Bellman.
    0 never ends early. Our choice."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "log_every", "check_every"):
            _within(f"run.{name}", getattr(self, name), 1, math.inf)
        _within("run.patience", self.patience, 0, math.inf)
        _within("run.seed", self.seed, 0, MOST_SEED)
        _one_of("run.keep", self.keep, ("target", "online"))
        _one_of("run.precision", self.precision, ("auto", "float32", "bfloat16"))


@dataclass(frozen=True)
class Settings:
    """All of it; the sections of a run's TOML file."""

    data: DataSettings = field(default_factory=DataSettings)
    network: NetworkSettings = field(default_factory=NetworkSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    run: RunSettings = field(default_factory=RunSettings)


def _within(name: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:
        wanted = f"at least {least}" if most == math.inf else f"from {least} to {most}"
        raise UsageError(f"{name} is {value}; it must be {wanted}.")


def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise UsageError(f"{name} is {value!r}; it must be one of: {', '.join(known)}.")
