"""Which model answers: from what a user said, the environment, and what is running."""

import os
from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.vlm.server import CONCURRENCY, DEFAULT_URL, TIMEOUT_S, URL_VARIABLE, find_model
from jiti.annotate.vlm.settings import SAMPLES, Settings
from jiti.errors import UsageError


@dataclass(frozen=True, slots=True)
class Wish:
    """What a user said about the model."""

    url: str | None = None
    model: str | None = None
    cameras: tuple[str, ...] = ()
    samples: int = SAMPLES
    fuse: bool = True
    concurrency: int = CONCURRENCY
    timeout_s: float = TIMEOUT_S


def choose(wish: Wish, *, asked: bool = True) -> Settings:
    """A server where an address is given or one runs at vLLM's usual one, else a model in this process.

    With `asked` off, for estimates, a server need not be there. Raises UsageError that says which model to start and
    how.
    """
    model, known = wish.model or "", os.environ.get(URL_VARIABLE, "")
    if not wish.url and model and (Path(model).is_dir() or not known):
        if not Path(model).is_dir() and "/" not in model:
            raise UsageError(
                f"--vlm-model {model} is neither a folder nor a Hub id such as nvidia/Cosmos-Reason2-2B; for a model "
                "of a server give its address with --vlm-url."
            )
        _check_installed()
        return _settings(wish, "", str(Path(model).resolve()) if Path(model).is_dir() else model)
    url = wish.url or known or DEFAULT_URL
    try:
        return _settings(wish, url, find_model(url, model))
    except UsageError:
        if asked:
            raise
        return _settings(wish, url, model)


def _settings(wish: Wish, url: str, model: str) -> Settings:
    return Settings(
        model,
        url,
        cameras=wish.cameras,
        samples=wish.samples,
        fuse=wish.fuse,
        concurrency=wish.concurrency,
        timeout_s=wish.timeout_s,
    )


def _check_installed() -> None:
    from importlib.util import find_spec

    missing = [name for name in ("torch", "transformers", "xgrammar") if find_spec(name) is None]
    if missing:
        raise UsageError(f"a model in this process needs {', '.join(missing)}. Run: pip install 'jiti[vlm]'")
