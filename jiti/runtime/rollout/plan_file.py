"""`plan.json`: what the rollouts of a folder have in common, what each guidance does, and the runs that played them."""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from jiti import __version__
from jiti.durable import write_atomic
from jiti.episodes.folder_reader import ROLLOUTS_FILE, ROLLOUTS_FORMAT, is_rollouts
from jiti.errors import SourceError, UsageError
from jiti.runtime.rollout.plan import RolloutPlan, label_of, settings_of
from jiti.runtime.rollout.result import RECORDING_SUFFIX, RESULT_SUFFIX

PACKAGES = ("lerobot", "torch", "mujoco", "robosuite", "hf-libero", "numpy")
"""Whose versions may change a number."""
_WEIGHTS = ("*.json", "*.safetensors")
TAU_FILE = "tau.json"
"""Thresholds that were calibrated, beside a critic's weights."""
_OF_TRAINING = frozenset({"train_config.json", TAU_FILE})
"""Files beside the weights that nothing depends on here."""


def fingerprint(folder: Path) -> str:
    """Hex digest of a policy's or critic's configuration and weights, whatever its place."""
    digest = hashlib.sha256()
    for path in sorted(p for pattern in _WEIGHTS for p in folder.glob(pattern)):
        if path.name not in _OF_TRAINING:
            digest.update(f"{path.name}\0".encode())
            with path.open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:16]


def policy_folder(policy: str) -> Path:
    """Where a policy's files are here; a Hub id's are fetched. Raises UsageError."""
    from jiti.critic.features.opened_policy import checkpoint_folder

    return checkpoint_folder(policy)


def critic_folder(critic: str) -> Path:
    """Where a critic's files are here; a Hub id's are fetched. Raises SourceError."""
    if Path(critic).expanduser().is_dir():
        folder = Path(critic).expanduser()
    else:
        try:
            folder = policy_folder(critic)
        except UsageError as error:
            raise SourceError(str(error)) from error
    if not (folder / "config.json").is_file():
        raise SourceError(
            f"{folder} is no critic: it has no config.json. Train one with `jiti train-critic DATASET --out RUN`."
        )
    return folder


def enter_plan(folder: Path, plan: RolloutPlan) -> dict[str, Any]:
    """Write the plan into its folder, beside what was played there before; give the file's content. A plan of which
    nothing was played, because its policy or critic was refused for instance, is forgotten.

    Raises UsageError that names what differs from the rollouts that are there.
    """
    shared = _shared(plan)
    before = _played_alike(folder, shared)
    critic = fingerprint(critic_folder(plan.critic)) if plan.critic is not None else None
    methods = {label_of(guidance): settings_of(guidance, critic) for guidance in plan.guidances}
    known = {label: before["methods"][label] for label in methods if before and label in before["methods"]}
    _check_same(folder, _flat(known), _flat({label: methods[label] for label in known}))
    content = {
        "format": ROLLOUTS_FORMAT,
        "shared": shared,
        "methods": {**before.get("methods", {}), **methods},
        "sources": _sources(plan, methods, before),
        "runs": [*before.get("runs", ()), _this_run(plan)],
    }
    write_atomic(folder / ROLLOUTS_FILE, json.dumps(content, indent=2).encode())
    return content


def check_folder(folder: Path, plan: RolloutPlan) -> None:
    """Raises UsageError where another task, scene or policy was played in a folder, SourceError where its `plan.json`
    is no plan."""
    if (folder / ROLLOUTS_FILE).exists():
        _played_alike(folder, _shared(plan))


def _played_alike(folder: Path, shared: Mapping[str, Any]) -> dict[str, Any]:
    """What was played in a folder before, with all of a plan's `shared` in common; empty where nothing was."""
    if not (folder / ROLLOUTS_FILE).exists():
        return {}
    before = _played_before(folder, shared)
    if before:
        _check_same(folder, before["shared"], shared)
    return before


def _shared(plan: RolloutPlan) -> dict[str, Any]:
    return {**plan.shared(), "policy": fingerprint(policy_folder(plan.policy))}


def _check_same(folder: Path, there: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Of another task all else differs too, and says nothing."""
    different = [key for key, value in wanted.items() if there.get(key) != value]
    if different:
        shown = ["task"] if "task" in different else different
        differs = [f"{key} {there.get(key)!r} and not {wanted[key]!r}" for key in shown]
        raise UsageError(
            f"{folder} holds rollouts with {', '.join(differs)}. Choose another folder with --out, or delete that one."
        )


def _played_before(folder: Path, shared: Mapping[str, Any]) -> dict[str, Any]:
    """The folder's plan with the guidances of which something was played; empty where nothing was. What it does not say
    is as in `shared`, a plan's."""
    content = read_plan(folder)
    if content["runs"]:  # where it is not shared yet, an older jiti wrote the device with each run
        content["shared"].setdefault("device", content["runs"][0].get("device"))
    for key in ("bddl", "pack"):  # of which an older jiti said nothing
        content["shared"].setdefault(key, shared[key])
    methods = {label: one for label, one in content["methods"].items() if _has_rollouts(folder / label)}
    return {**content, "methods": methods} if methods else {}


def _has_rollouts(folder: Path) -> bool:
    """Also of a recording whose result is missing: it is of the same plan."""
    return any(next(folder.glob(f"[!.]*{suffix}"), None) for suffix in (RESULT_SUFFIX, RECORDING_SUFFIX))


def _sources(plan: RolloutPlan, methods: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """Where policy and critic were; a run that asks no critic leaves the one that guided others."""
    critic = before.get("sources", {}).get("critic")
    if critic is None or any(settings.get("critic") for settings in methods.values()):
        critic = plan.critic
    return {"policy": plan.policy, "critic": critic}


def read_plan(folder: Path) -> dict[str, Any]:
    """Raises SourceError for a folder of something else."""
    try:
        if not is_rollouts(folder):
            raise ValueError("it was not written by jiti rollout")
        content = json.loads((folder / ROLLOUTS_FILE).read_bytes())
        if missing := {"shared", "methods", "runs"} - content.keys():
            raise ValueError(f"it lacks {', '.join(sorted(missing))}")
    except (OSError, ValueError) as error:
        raise SourceError(f"{folder / ROLLOUTS_FILE}: {error}. Choose another folder with --out.") from error
    return content


def _flat(methods: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"{label} {key}": value for label, settings in methods.items() for key, value in settings.items()}


def _this_run(plan: RolloutPlan) -> dict[str, Any]:
    return {
        "began": datetime.now(UTC).isoformat(timespec="seconds"),
        "hardware": hardware(),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Of jiti, Python and the packages that a rollout depends on, those that are installed."""
    found = {"jiti": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def hardware() -> dict[str, Any]:
    """Processor and cores that this process may use."""
    name = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text().splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return {"processor": name, "cores": cores, "system": platform.system()}
