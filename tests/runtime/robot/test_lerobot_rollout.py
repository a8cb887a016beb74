"""lerobot's own `lerobot-rollout` plays JITI around a policy on the virtual arm."""

import subprocess
import sys
from pathlib import Path
from time import sleep

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("scservo_sdk", reason="needs pip install 'jiti[robot]'")

from jiti.policies import save_jiti
from jiti.runtime.robot.virtual import VirtualArm
from tests.builders.robot_record import environment
from tests.runtime.candidates.conftest import TOLD, checkpoint, inputs, tiny_critic, tiny_flow

pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("ignore")]
NEAREST_DEG = 5.0
"""`robot.max_relative_target`: the weights are random."""
ATTEMPTS, SILENT = 4, "There is no status packet!"
"""lerobot's driver gives up after three tries of a few milliseconds: on a busy machine the virtual arm is late."""


def play(folder: Path, arm: VirtualArm, log: Path) -> tuple[int, str, float]:
    """lerobot's exit status, what it said, and how far a joint was from where it began at most, in rad."""
    command = [
        str(Path(sys.executable).with_name("lerobot-rollout")), "--strategy.type=base",
        "--discover_packages_path=jiti.policies", f"--policy.path={folder}", "--robot.type=so100_follower",
        f"--robot.port={arm.port}", f"--robot.id={arm.id}", f"--robot.calibration_dir={arm.calibration_dir}",
        f"--robot.max_relative_target={NEAREST_DEG}", f"--task={TOLD}", "--duration=3", "--fps=30", "--device=cpu",
    ]  # fmt: skip
    begin, farthest = np.array(list(arm.state().joints.values())), 0.0
    with log.open("w") as said:
        program = subprocess.Popen(command, env=environment(), stdout=said, stderr=subprocess.STDOUT)
        while program.poll() is None:  # in the end lerobot brings the arm back
            farthest = max(farthest, float(abs(np.array(list(arm.state().joints.values())) - begin).max()))
            sleep(0.1)
    return program.returncode, log.read_text(), farthest


def test_lerobots_rollout_plays_it_on_an_arm(tmp_path):
    base = checkpoint(tiny_flow(**inputs(state=6, scene=0, action=6), n_action_steps=4), tmp_path / "policy")
    folder = save_jiti(tmp_path / "jiti", base, tiny_critic(tmp_path / "critic", size=6, action=6), tau=0.1)
    for _ in range(ATTEMPTS):
        with VirtualArm("so100/T5") as arm:
            status, said, farthest = play(folder, arm, tmp_path / "said.txt")
        if status == 0 or SILENT not in said:
            break
    assert status == 0, said
    assert "Policy loaded: type=jiti" in said
    assert farthest > 0.1
