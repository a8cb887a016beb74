"""What stands between a dataset or an environment and the flow-matching policy: lerobot's usual steps."""

from typing import Any

import torch  # noqa: TID253 - lerobot's plugin, imported with the policy
from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors  # noqa: TID253

from jiti.policies.configuration_state_flow import StateFlowConfig

Before = PolicyProcessorPipeline[dict[str, Any], dict[str, Any]]
After = PolicyProcessorPipeline[PolicyAction, PolicyAction]


def make_state_flow_pre_post_processors(
    config: StateFlowConfig, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]:
    """Batch dimension, device and normalization before; the action's own unit after. lerobot finds this by its name."""
    return make_default_pre_post_processors(config, dataset_stats)
