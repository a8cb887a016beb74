"""Make a folder in which JITI around a base policy is a LeRobot policy."""

from pathlib import Path
from typing import Any

from jiti.errors import UsageError


def save_jiti(
    folder: str | Path, base: str | Path, critic: str | Path = "", *, device: str = "cpu", **settings: Any
) -> Path:
    """Write `config.json` and lerobot's two pipelines into `folder`; `settings` are those of `JitiConfig`: method,
    pick, candidates, window, tau, seed.

    Base and critic are opened first. Raises UsageError or SourceError for what is missing or does not fit together.
    """
    from jiti.policies.configuration_jiti import JitiConfig
    from jiti.policies.modeling_jiti import JitiPolicy
    from jiti.policies.processor_jiti import make_jiti_pre_post_processors

    try:
        config = JitiConfig(device=device, base=str(base), critic=str(critic), push_to_hub=False, **settings)
    except TypeError as error:
        raise UsageError(f"a setting of JITI: {error}. See jiti/policies/configuration_jiti.py.") from error
    JitiPolicy(config).save_pretrained(Path(folder))
    for part in make_jiti_pre_post_processors(config):
        part.save_pretrained(Path(folder))
    return Path(folder)
