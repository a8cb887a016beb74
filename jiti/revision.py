"""The revision of jiti's own code, which is kept with what it makes."""

import subprocess
from pathlib import Path


def git_revision() -> str | None:
    """The revision of the checkout that this code runs from, if it does."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return None
    asked = subprocess.run(["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return asked.stdout.strip() or None
