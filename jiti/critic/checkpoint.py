"""A training state on the disk: a critic's folder with `training.safetensors` and `training.json` beside. No pickles.

There is no state of a random generator or sampler: both are functions of (seed, step).
"""

import json
import shutil
from pathlib import Path

import torch  # noqa: TID253  imported by training only

from jiti.critic.critic import fill, load_tensors, save_critic, save_tensors
from jiti.critic.step import State
from jiti.durable import make_folder, sync_folder, write_atomic
from jiti.errors import SourceError

KEPT = 2
"""Checkpoints that are kept. Our choice: the last, and the one before in case that one is damaged."""


def save(state: State, folder: Path) -> None:
    """Write a checkpoint folder, in whole or not at all. Raises SaveFailed."""
    temporary = folder.with_name(f".tmp-{folder.name}")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        save_critic(state.critic, temporary, {"step": state.step})
        tensors = {f"target.{name}": value for name, value in state.target.state_dict().items()}
        tensors |= {"log_temperature": state.log_temperature, "log_multiplier": state.log_multiplier}
        for name, optimizer in state.optimizers.items():
            for place, kept in optimizer.state_dict()["state"].items():
                tensors |= {f"optimizer.{name}.{place}.{key}": value for key, value in kept.items()}
        save_tensors(temporary / "training.safetensors", tensors)
        rest = {"step": state.step, "best": state.best, "looks_without_better": state.looks_without_better}
        write_atomic(temporary / "training.json", json.dumps(rest, indent=2).encode())
        make_folder(folder.parent)
        shutil.rmtree(folder, ignore_errors=True)
        temporary.rename(folder)
        sync_folder(folder.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def load(state: State, folder: Path) -> None:
    """Put a checkpoint into a state that was made with the same settings. Raises SourceError for one of other sizes."""
    weights = load_tensors(folder / "model.safetensors")
    tensors = load_tensors(folder / "training.safetensors")
    for prefix, module, source in (
        ("q.", state.critic.q, weights),
        ("actor.", state.critic.actor, weights),
        ("target.", state.target, tensors),
    ):
        fill(module, {k.removeprefix(prefix): v for k, v in source.items() if k.startswith(prefix)}, folder)
    try:
        rest = json.loads((folder / "training.json").read_bytes())
        state.step, state.best = rest["step"], rest["best"]
        state.looks_without_better = rest["looks_without_better"]
        with torch.no_grad():
            state.log_temperature.copy_(tensors["log_temperature"])
            state.log_multiplier.copy_(tensors["log_multiplier"])
    except (OSError, ValueError, KeyError) as error:
        raise SourceError(
            f"{folder} is damaged: {error!r}. Delete it; training goes on from the one before."
        ) from error
    for name, optimizer in state.optimizers.items():
        content = optimizer.state_dict()
        for key, value in tensors.items():
            if key.startswith(f"optimizer.{name}."):
                place, what = key.removeprefix(f"optimizer.{name}.").split(".")
                content["state"].setdefault(int(place), {})[what] = value
        optimizer.load_state_dict(content)


def checkpoints(run: Path) -> list[Path]:
    """The checkpoints of a run, the newest first."""
    return sorted((run / "checkpoints").glob("step-*"), reverse=True)


def checkpoint_folder(run: Path, step: int) -> Path:
    return run / "checkpoints" / f"step-{step:08d}"


def drop_old(run: Path) -> None:
    """Remove all but the newest `KEPT`."""
    for folder in checkpoints(run)[KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)
