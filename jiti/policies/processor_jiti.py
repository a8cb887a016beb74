"""What stands between an environment and JITI: names, batch dimension and device; units stay what they are."""

from typing import Any

import torch  # noqa: TID253 - lerobot's plugin, imported with the policy
from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors  # noqa: TID253

from jiti.policies.configuration_jiti import JitiConfig


def make_jiti_pre_post_processors(
    config: JitiConfig, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]:
    """lerobot's usual steps, which normalize nothing here; lerobot finds this by its name."""
    return make_default_pre_post_processors(config, None)
