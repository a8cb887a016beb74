"""Settings of JITI around a base policy, in lerobot's form: `--policy.type=jiti`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from lerobot.configs.policies import PreTrainedConfig  # noqa: TID253 - this module is lerobot's plugin
from lerobot.configs.types import NormalizationMode  # noqa: TID253

from jiti.errors import UsageError
from jiti.nearest import nearest

if TYPE_CHECKING:
    from jiti.runtime.guidance import Guidance

UNTRAINED = "JITI trains nothing: train its base policy by `lerobot-train`, its critic by `jiti train-critic`."


@PreTrainedConfig.register_subclass("jiti")
@dataclass
class JitiConfig(PreTrainedConfig):
    """A frozen base policy and a critic, by reference, and what is done at each decision.

    What each number of the guidance means and where it is from stands in `jiti.runtime.guidance`.
    """

    base: str = ""
    """Folder of a checkpoint or of a run of lerobot-train, or Hub id. A relative path is looked for beside this config
    first, so that a folder may hold all that it needs."""
    critic: str = ""
    """Folder or Hub id, likewise; every method but `none` needs one."""

    method: str = "jiti"
    """none, jiti or full."""
    pick: str = "best"
    """best, median, worst or random."""
    candidates: int = 8
    window: int = 2
    tau: float | None = None
    """Threshold on delta_q, in the unit of Q; `jiti` alone needs it."""
    seed: int = 0
    """Of the first episode's noise; episode k has seed + k."""

    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("STATE", "ENV", "VISUAL", "ACTION"), NormalizationMode.IDENTITY)
    )
    """None here: the base policy's own pipelines are within."""

    @property
    def guidance(self) -> "Guidance":
        """Raises UsageError for settings that make no sense."""
        from jiti.runtime.guidance import Guidance, Method, Pick

        for name, known in (("method", get_args(Method)), ("pick", get_args(Pick))):
            if getattr(self, name) not in known:
                raise UsageError(f"policy.{name}: {nearest(getattr(self, name), known)}.")
        if self.seed < 0:
            raise UsageError(f"policy.seed is {self.seed}; it must be 0 or more.")
        chosen: dict[str, Any] = {"method": self.method, "pick": self.pick}
        return Guidance(**chosen, candidates=self.candidates, window=self.window, tau=self.tau)

    def found(self, reference: str) -> str:
        """A reference as it is opened: beside this config where it is there. Nothing stays nothing."""
        if reference and self.pretrained_path is not None and not Path(reference).is_absolute():
            beside = Path(self.pretrained_path) / reference
            if beside.is_dir():
                return str(beside)
        return reference

    def validate_features(self) -> None:
        """The base policy tells what it lacks."""

    def get_optimizer_preset(self) -> Any:
        raise UsageError(UNTRAINED)

    def get_scheduler_preset(self) -> None:
        return None

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> None:
        return None

    @property
    def reward_delta_indices(self) -> None:
        return None
