"""The demonstration that `jiti demo` shows is of the task and seed that were asked for last."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from jiti.episodes.mcap_writer import McapWriter
from jiti.errors import UsageError
from jiti.runtime.benchmark import demo
from jiti.runtime.benchmark.plan_file import read_plan
from jiti.runtime.sim.record import recorded_metadata
from jiti.runtime.sim.record_episode import OUTCOME
from jiti.tasks.catalogue import load_catalogue

PLAN = read_plan("demo")
CATALOGUE = load_catalogue()


@pytest.fixture
def recorded(monkeypatch) -> list[str]:
    """Names of what a simulator that only writes metadata recorded; nothing is proposed for it."""
    made: list[str] = []

    def record(plan, folder, *, graphics, **_options):
        folder.mkdir(exist_ok=True)
        path = plan.path(folder, 0)
        with McapWriter(path, instruction="put it there", metadata=plan.about(0, graphics) | {OUTCOME: "{}"}) as writer:
            writer.write_vector("/action", 0, ["x"], [0.0])
        made.append(path.stem)
        return [SimpleNamespace(path=path)]

    monkeypatch.setattr(demo, "record", record)
    monkeypatch.setattr(demo, "autolabel", lambda *_: None)
    return made


def shown(folder, task: str = "elegant/T2", **data: Any) -> dict[str, str]:
    """What is shown with these options says of itself."""
    demo._show_one(replace(PLAN, data=replace(PLAN.data, tasks=(task,), **data)), CATALOGUE.task(task), folder)
    return dict(recorded_metadata(folder / demo.SHOWN))


def test_what_is_shown_is_recorded_again_for_another_task_or_seed_alone(recorded, tmp_path):
    shown(tmp_path)
    shown(tmp_path)
    assert recorded == ["elegant-T2_0000"]
    assert shown(tmp_path, seed=3)["seed"] == "3"
    (tmp_path / ".episode").mkdir()
    (tmp_path / ".episode" / "elegant-T2_0003.mcap").write_bytes(b"of a run that was killed")
    assert shown(tmp_path, "elegant/T0")["task"] == "elegant/T0"
    assert recorded == ["elegant-T2_0000", "elegant-T2_0003", "elegant-T0_0000"]
    assert [path.name for path in tmp_path.iterdir()] == [demo.SHOWN]


def test_a_recording_of_someone_else_is_not_replaced(recorded, tmp_path):
    with McapWriter(tmp_path / demo.SHOWN, instruction="put it there") as writer:
        writer.write_vector("/action", 0, ["x"], [0.0])
    with pytest.raises(UsageError, match=r"episode\.mcap is another recording.*Move that file away"):
        shown(tmp_path)
    assert recorded == []
