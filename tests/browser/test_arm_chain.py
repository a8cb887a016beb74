"""From demonstrations on the virtual arm, labelled by keys in the annotator, to a policy that acts there, and
to keys that judge it: with jiti's own commands alone."""

import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from jiti.annotate.labels import read_segments
from jiti.policies import recipe_path
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.take import ENTER, TIME
from jiti.runtime.robot.virtual import VirtualArm
from tests.builders import robot_record
from tests.builders.robot_record import at_terminal, jiti

pytest.importorskip("lerobot", reason="pip install 'jiti[robot]'")
pytest.importorskip("scservo_sdk", reason="pip install 'jiti[robot]'")
pytestmark = [pytest.mark.browser, pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(1200)]
DEMONSTRATIONS, STEPS, CHUNK, ROLLOUTS = 10, 2500, 30, 5
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


def annotate(serve, screen, folder: Path) -> list[int]:
    """Mark the end of the queue's first two demonstrations by keys, the one as good and the other as bad; the rewards
    that are kept, in the order of the keys."""
    page = screen(serve("annotate", "demos", folder=folder).url).ready()
    for verdict, go in (("p", "n"), ("f", "n")):
        page.press("End", "w").wait(segments=1, version=1).press(verdict).wait(version=2).press(go)
        page.wait(segments=0, version=0)
    assert not page.errors
    rows = read_segments(folder / "demos" / "labels").to_pylist()
    kept = sorted((row["created_at"], row["episode_id"], row["reward"]) for row in rows if row["source"] == "human")
    assert len({episode_id for _, episode_id, _ in kept}) == 2
    return [reward for _, _, reward in kept]


def test_a_policy_learns_from_demonstrations_to_push_the_drawer(serve, screen, tmp_path):
    """It sees its joints alone, and does not know when the drawer is shut: each rollout is ended by a key once that is
    half shut, or after 7 s, before an arm that presses on overloads a servo."""
    options = ["--task", "so100/T5", "--episodes", str(DEMONSTRATIONS), "--quality", "1", "--out", "demos"]
    command = jiti("record", "--robot", "so100", "--port", "virtual", "--leader", "virtual", *options)
    with at_terminal(command, tmp_path / "said.txt") as keyboard:
        keyboard.wait_for("[Enter] begin")
        for number in range(1, DEMONSTRATIONS):
            keyboard.press("\n", f"[Enter] begin  [r] record so100-T5_{number - 1:04d}.mcap anew", 120)
        keyboard.press("\n", "[Enter] end", 120)
        keyboard.press("\n", f"{DEMONSTRATIONS} of {DEMONSTRATIONS} episodes")
        assert keyboard.program.wait(60) == 0
    run(tmp_path, *jiti("autolabel", "demos", "--from", "signal"))
    proposed = read_segments(tmp_path / "demos" / "labels").to_pylist()
    assert len({row["episode_id"] for row in proposed if row["source"] == "signal"}) == DEMONSTRATIONS
    assert annotate(serve, screen, tmp_path) == [1, 0]
    (tmp_path / "features.toml").write_text(FEATURES)
    options = ["--unlabelled", "keep", "--features", "features.toml", "--fps", "30"]
    assert f"{DEMONSTRATIONS} episodes" in run(tmp_path, *jiti("curate", "demos", "--out", "dataset", *options))
    run(
        tmp_path, str(Path(sys.executable).with_name("lerobot-train")),
        "--policy.discover_packages_path=jiti.policies", f"--config_path={recipe_path('state_flow')}",
        "--dataset.root=dataset", "--output_dir=run", f"--steps={STEPS}", f"--save_freq={STEPS}",
        f"--policy.chunk_size={CHUNK}", f"--policy.n_action_steps={CHUNK}", "--policy.frequencies=0",
    )  # fmt: skip
    with VirtualArm("so100/T5") as arm:
        config = tmp_path / "arm.toml"
        folder = str(arm.calibration_dir)
        robot_record.write_settings(config, RobotSettings(port=arm.port, id=arm.id, calibration_dir=folder, lost_s=1.0))
        options = ["--policy", "run/checkpoints/last/pretrained_model", "--seconds", "7", "--out", "rollouts"]
        asked = ["--robot-config", str(config), "--task", "so100/T5", "--judge", "--episodes", str(ROLLOUTS), *options]
        with at_terminal(jiti("rollout", *asked), tmp_path / "judged.txt") as keyboard:
            keyboard.wait_for("[Enter] begin", seconds=120)
            pushed = [pushes(arm, keyboard, number) for number in range(ROLLOUTS)]
            keyboard.press("\n", "Judged by a person, 95% intervals by Wilson")
            assert keyboard.program.wait(60) == 0
    assert sum(pushed) > ROLLOUTS / 2
    rows = pq.read_table(tmp_path / "rollouts" / "evaluation.parquet").to_pylist()
    assert [(row["guidance"], row["success"]) for row in rows] == [("none", success) for success in pushed]
    assert [row["ended"] for row in rows] == [ENTER if success else TIME for success in pushed]
    assert [dict(row["itcs"]) for row in rows] == [{"so100/T5/shut-smoothly": False}] * ROLLOUTS
    labels = read_segments(tmp_path / "rollouts" / "judged" / "labels").to_pylist()
    assert [(label["source"], label["reward"]) for label in labels] == [("human", 0)] * ROLLOUTS


def pushes(arm: VirtualArm, keyboard: robot_record.Keyboard, number: int) -> bool:
    """Lay out the things of an episode, begin it, end it by a key once the drawer is half shut, and judge it.

    Judged is what was seen at that key: on its way back to rest the arm may drag the drawer open again.
    """
    arm.reset(50 + number)
    before = arm.state().drawers["top_drawer"]
    assert before > 0.04, "metres that it stands open"
    said = len(keyboard.said())
    keyboard.press("\n", "Space stops the arm at once", 120)

    def asked() -> bool:
        return "Did it succeed?" in keyboard.said()[said:]

    keyboard.watch(lambda: arm.state().drawers["top_drawer"] < before / 2 or asked(), seconds=120)
    pushed = not asked()
    if pushed:
        keyboard.press("\n", "Did it succeed?", 120)
    keyboard.press("y" if pushed else "n", "The drawer must be closed smoothly")
    keyboard.press("n", "[Enter] begin" if number + 1 < ROLLOUTS else "[Enter] tell")
    return pushed
