"""The whole chain, made small: it ends, and goes on."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from jiti.annotate.labels import read_labels

pytestmark = [pytest.mark.sim, pytest.mark.slow, pytest.mark.timeout(1800)]
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}


@pytest.fixture(autouse=True)
def _learning() -> None:
    pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")


def jiti(here: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "jiti", *arguments]
    return subprocess.run(command, cwd=here, env=ENVIRONMENT, capture_output=True, text=True, check=False)


def test_every_column_of_table_8_is_played_and_kept(tmp_path):
    command = ("benchmark", "--plan", "table8", "--out", "work", "--quick", "--json")
    first = jiti(tmp_path, *command)
    assert first.returncode == 0, first.stderr
    told = json.loads(first.stdout)
    assert told["missing"] == []
    assert {name: column["average"]["rollouts"] for name, column in told["columns"].items()} == dict.fromkeys(
        ("base", "filtered", "weighted", "jiti", "full", "sparse", "random", "median", "worst", "jiti-filtered"), 2
    )
    html = (tmp_path / told["report"]).read_text()
    assert "proves nothing but that it runs" in html
    assert str(tmp_path) not in html
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "work").rglob("*.safetensors")}
    again = jiti(tmp_path, *command)
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout) == told
    assert {path: path.stat().st_mtime_ns for path in before} == before
    refused = jiti(tmp_path, "benchmark", "--out", "work", "--quick", "--columns", "bases")
    assert refused.returncode == 1
    assert "did you mean 'base'?" in refused.stderr


def test_the_demo_leaves_a_folder_in_which_the_commands_run_as_they_are_written(tmp_path):
    done = jiti(tmp_path, "demo", "--quick", "--headless")
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "jiti-demo"
    for said in ("8 demonstrations", "none", "full", "jiti annotate episode.mcap", "jiti rollout"):
        assert said in done.stdout
    for made in ("episode.mcap", "report.html", "report.md", "labels"):
        assert (folder / made).exists(), made
    accepted = read_labels(folder / "labels").segments
    assert accepted["status"].to_pylist().count("accepted") >= 8
    checked = jiti(folder, "validate-rewards", "--check")
    assert checked.returncode == 0, checked.stdout
    assert "8 segments" in checked.stdout
    rollout = jiti(folder, "rollout", "--episodes", "1", "--max-steps", "30", "--json")
    assert rollout.returncode == 0, rollout.stderr
    assert {method["label"] for method in json.loads(rollout.stdout)["methods"]} == {"none", "jiti"}
    vlm = jiti(folder, "autolabel", "--vlm", "--vlm-url", "http://127.0.0.1:9/v1")
    assert vlm.returncode == 1
    assert "no model server answers" in vlm.stderr
