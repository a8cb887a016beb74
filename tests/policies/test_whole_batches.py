"""Batches read at once hold what items read one by one hold, and `lerobot-train` learns from them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

import numpy as np  # noqa: E402

from jiti.policies import RECIPES, recipe_path  # noqa: E402

# lerobot warns of its own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")

LENGTHS = (7, 3, 12, 5)
AHEAD = {"action": [0.0, 0.05, 0.1, 0.15], "observation.state": [-0.05, 0.0]}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Four short episodes of two tasks, with the columns of D_elegant."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    def numbers(size, dtype="float32"):
        return {"dtype": dtype, "shape": (size,), "names": None}

    root = tmp_path_factory.mktemp("data") / "elegant"
    made = LeRobotDataset.create(
        "local/elegant",
        fps=20,
        root=root,
        use_videos=False,
        features={
            "observation.state": numbers(3),
            "observation.environment_state": numbers(5),
            "action": numbers(2),
            "next.reward": numbers(1),
            "next.done": numbers(1, "bool"),
            "elegance.annotated": numbers(1, "bool"),
        },
    )
    rng = np.random.default_rng(0)
    for episode, length in enumerate(LENGTHS):
        for frame in range(length):
            made.add_frame(
                {
                    "observation.state": rng.normal(size=3).astype(np.float32),
                    "observation.environment_state": rng.normal(size=5).astype(np.float32),
                    "action": np.float32([frame, 1 - 2 * (frame % 2)]),
                    "next.reward": np.float32([frame % 2]),
                    "next.done": np.array([frame == length - 1]),
                    "elegance.annotated": np.array([True]),
                    "task": ("put it there", "push it away")[episode % 2],
                }
            )
        made.save_episode()
    made.finalize()
    return root


@pytest.mark.parametrize("episodes", [None, [1, 2], [0, 3]])
def test_a_batch_is_the_same_number_by_number(dataset, episodes):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import default_collate

    from jiti.policies.whole_batches import items

    opened = LeRobotDataset("local/elegant", root=dataset, episodes=episodes, delta_timestamps=AHEAD)
    indices = [*range(len(opened)), 0, len(opened) - 1]
    expected, found = default_collate([opened[i] for i in indices]), default_collate(items(opened, indices))
    assert type(found) is dict
    assert set(found) == set(expected)
    for key, value in expected.items():
        if key == "task":
            assert found[key] == value
        else:
            assert found[key].dtype == value.dtype
            assert torch.equal(found[key], value), key


def test_a_loader_asks_for_whole_batches(dataset, monkeypatch):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from jiti.policies.whole_batches import install

    install()
    opened = LeRobotDataset("local/elegant", root=dataset, delta_timestamps=AHEAD)
    monkeypatch.setattr(LeRobotDataset, "__getitem__", lambda *_: pytest.fail("read one by one"))
    (batch,) = torch.utils.data.DataLoader(opened, batch_size=len(opened))
    assert batch["action"].shape == (sum(LENGTHS), 4, 2)
    assert batch["action_is_pad"].sum() == len(LENGTHS) * (1 + 2 + 3)
    (some,) = torch.utils.data.DataLoader(torch.utils.data.Subset(opened, [3, 5]), batch_size=2)
    assert torch.equal(some["action"], batch["action"][[3, 5]])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_lerobot_train_learns_from_a_recipe_and_goes_on_where_it_was(dataset, tmp_path):
    from lerobot.configs.policies import PreTrainedConfig

    import jiti.policies

    train = str(Path(sys.executable).with_name("lerobot-train"))
    command = [train, "--policy.discover_packages_path=jiti.policies", f"--dataset.root={dataset}"]
    small = ["--policy.width=32", "--policy.depth=1", "--batch_size=16", f"--output_dir={tmp_path / 'run'}"]
    told = {"env": os.environ | {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}, "check": True, "capture_output": True}
    recipe = f"--config_path={recipe_path('state_flow')}"
    subprocess.run([*command, recipe, *small, "--steps=4", "--save_freq=2"], **told)
    checkpoint = tmp_path / "run" / "checkpoints" / "000002" / "pretrained_model"
    jiti.policies.register()
    config = PreTrainedConfig.from_pretrained(checkpoint)
    assert config.instructions == ["put it there", "push it away"]
    saved = json.loads((checkpoint / "train_config.json").read_text())
    assert saved["policy"]["type"] == "state_flow"
    last = tmp_path / "run" / "checkpoints" / "last" / "pretrained_model"
    subprocess.run([*command, f"--config_path={last / 'train_config.json'}", "--resume=true", "--steps=6"], **told)
    assert (tmp_path / "run" / "checkpoints" / "000006" / "pretrained_model" / "model.safetensors").is_file()


def test_each_recipe_is_a_file():
    for name in RECIPES:
        assert json.loads(recipe_path(name).read_text())["steps"] > 0
