"""Our LeRobot policies, a small flow-matching one from state and JITI around any, and recipes for `lerobot-train`.

    lerobot-train --policy.discover_packages_path=jiti.policies --config_path=state_flow.json --dataset.root=...

lerobot finds a policy's parts by the names of modules: `configuration_state_flow`, `modeling_state_flow` and
`processor_state_flow`, and the same of `jiti`, which `save_jiti` makes a folder of. Importing this package imports
none of them; `register` does, for a program that opens policies. The recipes are in `recipes/`, and `recipe_path` says
where.
"""

from jiti.policies.around import save_jiti
from jiti.policies.recipe import RECIPES, recipe_path

__all__ = ["RECIPES", "recipe_path", "register", "save_jiti"]


def register() -> None:
    """Make lerobot know our policies, so that `PreTrainedConfig.from_pretrained` opens their folders; takes seconds."""
    import jiti.policies.configuration_jiti
    import jiti.policies.configuration_state_flow  # noqa: F401
