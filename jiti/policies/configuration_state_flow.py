"""Settings of the flow-matching policy from state, in lerobot's form: `--policy.type=state_flow`."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.policies import PreTrainedConfig  # noqa: TID253 - this module is lerobot's plugin
from lerobot.configs.types import NormalizationMode  # noqa: TID253
from lerobot.optim import AdamWConfig, CosineDecayWithWarmupSchedulerConfig  # noqa: TID253

from jiti.curate.export.features import ENVIRONMENT_STATE, STATE
from jiti.errors import UsageError


@PreTrainedConfig.register_subclass("state_flow")
@dataclass
class StateFlowConfig(PreTrainedConfig):
    """A chunk of actions from the robot's state, the scene's state and the instruction; no pictures."""

    chunk_size: int = 10
    """K, actions that are predicted at once. Supplement C.4: the critic's chunks have 10."""
    n_action_steps: int = 10
    """Actions of a chunk that are executed before the next is drawn. Our choice: all; a critic judges whole chunks."""
    num_steps: int = 8
    """Euler steps from noise to a chunk. Our choice: the prototype had as many, and each costs a pass."""

    width: int = 256
    """Numbers of a layer. Our choice: minutes on two cores, where 512 has four times the arithmetic."""
    depth: int = 4
    """Residual blocks of two layers each behind the observation's encoder. Our choice."""
    frequencies: int = 2
    """Octaves in which each observed number is also seen as sine and cosine. Our choice: over all tasks a number's
    spread is some decimetres, and millimetres decide."""
    observation_limit: float = 5.0
    """Standard deviations at which an observed number is cut off. Our choice: what hardly varied in the data must not
    grow without bounds in a new scene."""

    draws: int = 4
    """Noise draws for each frame of a batch. Our choice: reading a frame through LeRobotDataset takes longer than
    learning from it, so each is used this often with other noise and another time."""
    ema_decay: float = 0.999
    """Of the average of weights that acts. Our choice, usual for diffusion policies."""

    instructions: list[str] = field(default_factory=list)
    """Instructions that are told apart, by their place; from the dataset where empty. Any other is all zeros."""

    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "STATE": NormalizationMode.MEAN_STD,
            "ENV": NormalizationMode.MEAN_STD,
            "ACTION": NormalizationMode.MEAN_STD,
        }
    )

    optimizer_lr: float = 1e-3
    optimizer_weight_decay: float = 1e-4
    optimizer_grad_clip_norm: float = 1.0
    scheduler_warmup_steps: int = 1_000
    scheduler_decay_steps: int = 100_000
    scheduler_decay_lr: float = 2e-5
    """All six are our choice, tried on LIBERO-Elegant's eight tasks. lerobot shortens warmup and decay to the steps of
    a run that has fewer: one of 30,000 warms up for 300, and ends where the rate does."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sizes = ("chunk_size", "n_action_steps", "num_steps", "width", "depth", "draws")
        for name in sizes:
            if getattr(self, name) < 1:
                raise UsageError(f"policy.{name} is {getattr(self, name)}; it must be at least 1.")
        if self.n_action_steps > self.chunk_size:
            raise UsageError(
                f"policy.n_action_steps is {self.n_action_steps}, more than the {self.chunk_size} of policy.chunk_size."
            )
        if not 0 <= self.ema_decay < 1:
            raise UsageError(f"policy.ema_decay is {self.ema_decay}; it must be at least 0 and less than 1.")

    def validate_features(self) -> None:
        """Raises UsageError where there is no state or action."""
        if self.robot_state_feature is None and self.env_state_feature is None:
            raise UsageError(
                f"state_flow needs {STATE} or {ENVIRONMENT_STATE} in the dataset; it has: "
                f"{', '.join(self.input_features or {}) or 'neither'}. A policy for pictures is --policy.type=smolvla."
            )
        if self.action_feature is None:
            raise UsageError("state_flow needs `action` in the dataset.")

    def get_optimizer_preset(self) -> AdamWConfig:
        return AdamWConfig(
            lr=self.optimizer_lr,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        return CosineDecayWithWarmupSchedulerConfig(
            peak_lr=self.optimizer_lr,
            decay_lr=self.scheduler_decay_lr,
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
        )

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> list[int]:
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        return None

    def observed(self) -> dict[str, int]:
        """Keys of a batch that are seen, with how many numbers each has."""
        features: dict[str, Any] = self.input_features or {}
        return {key: features[key].shape[0] for key in (STATE, ENVIRONMENT_STATE) if key in features}
