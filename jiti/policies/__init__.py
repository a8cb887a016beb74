"""Base policies: a small flow-matching one from state, as a LeRobot policy, and recipes for `lerobot-train`.

    lerobot-train --policy.discover_packages_path=jiti.policies --config_path=state_flow.json --dataset.root=...

lerobot finds the policy's parts by the names of modules: `configuration_state_flow`, `modeling_state_flow` and
`processor_state_flow`. Importing this package imports none of them; `register` does, for a program that opens
policies. The recipes are in `recipes/`, and `recipe_path` says where.
"""

from jiti.policies.recipe import RECIPES, recipe_path

__all__ = ["RECIPES", "recipe_path", "register"]


def register() -> None:
    """Make lerobot know our policy, so that `PreTrainedConfig.from_pretrained` opens its checkpoints; takes seconds."""
    import jiti.policies.configuration_state_flow  # noqa: F401
