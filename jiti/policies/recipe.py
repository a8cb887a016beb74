"""The recipes that come with the package: files for `lerobot-train --config_path`."""

from pathlib import Path

from jiti.errors import UsageError

FOLDER = Path(__file__).parent / "recipes"

RECIPES = {
    "state_flow": "our flow-matching policy from state, all tasks in one, minutes on two cores",
    "smolvla": "SmolVLA-500M, supplement C.3",
    "pi05": "pi0.5, supplement C.1",
    "groot": "GR00T-N1.7, which lerobot 0.6 trains, with the numbers of supplement C.2",
    "groot_n15": "GR00T-N1.5, supplement C.2, for lerobot 0.5.1",
}
"""What each recipe trains."""


def recipe_path(name: str) -> Path:
    """The file of a recipe. Raises UsageError for one that there is not."""
    if name not in RECIPES:
        raise UsageError(f"there is no recipe {name}; there are: {', '.join(RECIPES)}.")
    return FOLDER / f"{name}.json"
