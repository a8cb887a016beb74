"""What `jiti train-critic` was asked, checked before anything heavy is imported."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jiti.critic.dataset import read_elegant
from jiti.critic.settings_file import read_settings
from jiti.errors import UsageError
from jiti.progress import Progress


@dataclass(frozen=True)
class Request:
    """The command's arguments."""

    dataset: Path | None
    out: Path | None
    config: Path | None
    features: str | None
    steps: int | None
    seed: int | None
    workers: int
    cache: Path | None
    evaluate: Path | None
    split: str | None
    """None: test."""
    episodes: tuple[int, ...]


@dataclass(frozen=True)
class Done:
    """What to print."""

    text: str
    content: dict[str, Any]

    def __str__(self) -> str:
        return self.text

    def to_json(self) -> str:
        return json.dumps(self.content, indent=2)


def train_request(request: Request, progress: Progress) -> Done:
    """Train, or go on. Raises UsageError for arguments that do not fit together."""
    if request.dataset is None:
        raise UsageError(
            "train-critic needs a dataset: jiti train-critic DATASET --out RUN. Make one with `jiti curate`."
        )
    if request.out is None:
        raise UsageError(f"--out RUN is missing: jiti train-critic {request.dataset} --out run")
    for name, given in (("episode", request.episodes), ("split", request.split)):
        if given:
            raise UsageError(f"--{name} is of --evaluate RUN.")
    settings = read_settings(request.config)
    if request.features is not None:
        settings = replace(settings, data=replace(settings.data, features=request.features))
    run = {name: value for name in ("steps", "seed") if (value := getattr(request, name)) is not None}
    settings = replace(settings, run=replace(settings.run, **run))
    data = read_elegant(request.dataset)  # before torch, which takes seconds, so that a wrong path is told at once
    progress(0, "loading torch")
    from jiti.critic.train import train

    trained = train(
        request.dataset,
        request.out,
        settings,
        features_dir=request.cache,
        workers=request.workers,
        progress=progress,
        data=data,
    )
    about = {"run": str(trained.run), "step": trained.step, "best": trained.best, "early": trained.stopped_early}
    return Done(str(trained), about)


def evaluate_request(request: Request, progress: Progress) -> Done:
    """Evaluate a run. Raises UsageError for arguments that do not fit together."""
    given = ("out", "config", "features", "steps", "seed")
    if wrong := [name for name in given if getattr(request, name) is not None]:
        raise UsageError(f"--{wrong[0]} is of training; --evaluate RUN takes what the run was trained with.")
    assert request.evaluate is not None
    progress(0, "loading torch")
    from jiti.critic.evaluate import evaluate, to_json

    found = evaluate(
        request.evaluate,
        request.dataset,
        split=request.split or "test",
        episodes=request.episodes,
        features_dir=request.cache,
        workers=request.workers,
        progress=progress,
    )
    return Done(str(found), to_json(found))
