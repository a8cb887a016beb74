"""Observations of several steps as one, for policies that look back."""

from collections.abc import Sequence
from typing import Any

import torch  # noqa: TID253 - imported when a policy is opened

_NUMBERS = ("observation.state", "observation.environment_state", "observation.image")


def stacked(prepared: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Numbers and pictures (1, T, ...) of T prepared observations, the oldest first; all else is the newest's."""
    newest = prepared[-1]
    return newest | {
        key: torch.stack([step[key] for step in prepared], dim=1) for key in newest if key.startswith(_NUMBERS)
    }
