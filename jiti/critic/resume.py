"""Whether a run may go on: only as what it was begun, with the same settings, data and features."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jiti.critic.checkpoint import checkpoints
from jiti.critic.settings import Settings
from jiti.critic.settings_file import differences, settings_from
from jiti.errors import SourceError, UsageError

MAY_CHANGE = {"run.steps", "run.patience", "run.device", "run.log_every", "run.check_every"}
"""Settings with which a run may go on."""
MUST_STAY = {
    ("dataset", "fingerprint"): "dataset (its frames, labels or videos)",
    ("dataset", "gamma"): "discount",
    ("dataset", "train"): "choice of training episodes",
    ("extractor", "fingerprint"): "features (another extractor, or other weights of it)",
}
"""What `config.json` says of a run beside its settings that must be the same, and how that is called."""


@dataclass(frozen=True)
class Begun:
    """The newest checkpoint of a run."""

    folder: Path
    config: Mapping[str, Any]

    def check(self, about: Mapping[str, Any]) -> None:
        """Raises UsageError, naming what changed, unless the run goes on with the same data and features.

        What an older run's config does not say is not compared.
        """
        changed = [
            said
            for (part, name), said in MUST_STAY.items()
            if name in self.config.get(part, {}) and self.config[part][name] != about[part][name]
        ]
        if changed:
            run, what = self.folder.parents[1], " and another ".join(changed)
            raise UsageError(
                f"--out {run} holds a run with another {what}. Name another folder, or pass what it was begun with."
            )


def begun_run(run: Path, settings: Settings) -> Begun | None:
    """The newest checkpoint of a run with these settings, or None where there is none. Raises UsageError."""
    found = checkpoints(run)
    if not found:
        if run.exists() and any(run.iterdir()) and not (run / "metrics").exists():
            raise UsageError(f"--out {run} is not empty, and no run of this command. Name another folder.")
        return None
    try:
        config = json.loads((found[0] / "config.json").read_bytes())
        old = settings_from(config["settings"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(
            f"{found[0]} is damaged: {error!r}. Delete it; training goes on from the one before."
        ) from error
    if changed := [name for name in differences(old, settings) if name not in MAY_CHANGE]:
        told = ", ".join(f"{name} ({_value(old, name)} there, {_value(settings, name)} asked for)" for name in changed)
        raise UsageError(
            f"--out {run} holds a run with another {told}. Name another folder, or pass the --config, --features and "
            "--seed that it was begun with."
        )
    return Begun(found[0], config)


def _value(settings: Settings, name: str) -> str:
    section, _, key = name.partition(".")
    return str(getattr(getattr(settings, section), key))
