"""Folders that look like a policy's and a critic's: what plays is given by `make_agent`."""

import json
from pathlib import Path

import pytest

from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.plan import RolloutPlan
from jiti.tasks.catalogue import load_catalogue

TASK = load_catalogue().task("elegant/T2")
STEPS = 45
"""Of an episode: five decisions."""
NONE, JITI, FULL = Guidance("none"), Guidance("jiti", tau=1.0), Guidance("full", candidates=4)


def write_policy(folder: Path, weights: bytes = b"policy") -> Path:
    folder.mkdir(parents=True)
    config = {"type": "state_flow", "input_features": {}, "output_features": {"action": {}}}
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "model.safetensors").write_bytes(weights)
    return folder


def write_critic(folder: Path, weights: bytes = b"critic") -> Path:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({"network": {}, "sizes": {}, "version": 1}))
    (folder / "model.safetensors").write_bytes(weights)
    return folder


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    return write_policy(tmp_path / "policy")


@pytest.fixture
def critic(tmp_path: Path) -> Path:
    return write_critic(tmp_path / "critic")


@pytest.fixture
def plan(policy: Path, critic: Path) -> RolloutPlan:
    return RolloutPlan(TASK, str(policy), str(critic), (NONE, JITI, FULL), seed=7, most_steps=STEPS)
