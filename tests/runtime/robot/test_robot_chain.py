"""From a demonstration on the virtual arm to a policy that does the task there, with jiti's own commands alone."""

import subprocess
import sys
from pathlib import Path

import pytest

from jiti.policies import recipe_path
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.virtual import VirtualArm
from tests.builders import robot_record
from tests.builders.robot_record import at_terminal, jiti

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(1200)]
DEMONSTRATIONS, STEPS, CHUNK = 6, 2000, 30
FEATURES = """
[features."observation.state"]
streams = ["/joints"]

[features."action"]
streams = ["/action"]
"""


def run(folder: Path, *command: str) -> str:
    done = subprocess.run(
        command, cwd=folder, env=robot_record.environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_a_policy_learns_from_demonstrations_to_close_the_drawer(tmp_path):
    """It sees its joints alone, not the drawer: of six such rollouts four shut it, and all pushed it at least 2 cm."""
    options = ["--task", "so100/T5", "--episodes", str(DEMONSTRATIONS), "--quality", "1", "--out", "demos"]
    command = jiti("record", "--robot", "so100", "--port", "virtual", "--leader", "virtual", *options)
    with at_terminal(command, tmp_path / "said.txt") as keyboard:
        keyboard.wait_for("so100-T5_0000.mcap: Enter begins")
        for number in range(1, DEMONSTRATIONS):
            keyboard.press("\n", f"so100-T5_{number:04d}.mcap: Enter begins", 120)
        keyboard.press("\n", "All are there: Enter ends", 120)
        keyboard.press("\n", f"{DEMONSTRATIONS} of {DEMONSTRATIONS} episodes")
        assert keyboard.program.wait(60) == 0
    assert f"{DEMONSTRATIONS} proposals" in run(tmp_path, *jiti("autolabel", "demos", "--from", "signal"))
    (tmp_path / "features.toml").write_text(FEATURES)
    options = ["--unlabelled", "keep", "--features", "features.toml", "--fps", "30"]
    assert f"{DEMONSTRATIONS} episodes" in run(tmp_path, *jiti("curate", "demos", "--out", "dataset", *options))
    run(
        tmp_path, str(Path(sys.executable).with_name("lerobot-train")),
        "--policy.discover_packages_path=jiti.policies", f"--config_path={recipe_path('state_flow')}",
        "--dataset.root=dataset", "--output_dir=run", f"--steps={STEPS}", f"--save_freq={STEPS}",
        f"--policy.chunk_size={CHUNK}", f"--policy.n_action_steps={CHUNK}",
    )  # fmt: skip
    with VirtualArm("so100/T5", seed=50) as arm:
        config = tmp_path / "arm.toml"
        folder = str(arm.calibration_dir)
        robot_record.write_settings(config, RobotSettings(port=arm.port, id=arm.id, calibration_dir=folder, lost_s=1.0))
        before = arm.state().drawers["top_drawer"]
        options = ["--policy", "run/checkpoints/last/pretrained_model", "--seconds", "12", "--out", "rollouts"]
        run(tmp_path, *jiti("rollout", "--robot-config", str(config), "--task", "so100/T5", *options))
        after = arm.state().drawers["top_drawer"]
    assert before > 0.07
    assert after < before - 0.01, "metres that it stands open"
