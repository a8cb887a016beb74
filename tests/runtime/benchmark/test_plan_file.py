"""A plan is read as it is written, and every mistake in it is told with its line."""

from dataclasses import replace
from pathlib import Path

import pytest

from jiti.errors import UsageError
from jiti.runtime.benchmark.plan import smaller
from jiti.runtime.benchmark.plan_file import read_plan, shipped_plans
from jiti.tasks.catalogue import load_catalogue

GOOD = """\
title = "two"

[data]
tasks = ["elegant/T0", "elegant/T2"]
episodes = 10

[critic]
tasks = ["elegant/T0"]
[critic.settings.loss]
alpha = 0.5

[groups]
unseen = ["elegant/T2"]

[[column]]
name = "base"
seeds = [0, 1]

[[column]]
name = "jiti"
method = "jiti"
paper = "jiti"

[[compare]]
first = "base"
second = "jiti"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", shipped_plans())
def test_the_plans_of_the_package_can_be_read_and_made_small(name):
    plan = read_plan(name)
    known = {task.task_id for task in load_catalogue() if task.bddl}
    assert set(plan.data.tasks) <= known
    small = smaller(plan)
    assert small.quick
    assert [column.name for column in small.columns] == [column.name for column in plan.columns]
    assert small.tasks[0] == plan.tasks[0]


def test_a_plan_has_what_its_file_says(tmp_path):
    plan = read_plan(write(tmp_path, GOOD))
    assert (plan.name, plan.title, plan.data.episodes, plan.data.quality) == ("own", "two", 10, 0.5)
    assert plan.tasks == ("elegant/T0", "elegant/T2")
    assert plan.critic_tasks == ("elegant/T0",)
    assert plan.critic.settings == {"loss": {"alpha": 0.5}}
    assert [(c.name, c.method, c.seeds) for c in plan.columns] == [("base", "none", (0, 1)), ("jiti", "jiti", (0,))]
    assert plan.groups == {"unseen": ("elegant/T2",)}
    tuned = replace(plan, tuning=True)
    assert (plan.seed, tuned.seed, tuned.episodes) == (100_000, 300_000, 10)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("episodes = 10", "episode = 10", 5, "data has no key 'episode'; did you mean 'episodes'?"),
        ("episodes = 10", 'episodes = "ten"', 5, "data.episodes is 'ten'; it must be a whole number"),
        ("episodes = 10", "quality = 2", 5, "data.quality is 2; it must be from 0 to 1"),
        ("[critic]", "[critics]", 7, "a plan has no 'critics'; did you mean 'critic'?"),
        ('tasks = ["elegant/T0"]', 'tasks = ["elegant/T1"]', 8, "critic.tasks is 'elegant/T1'; did you mean"),
        ('method = "jiti"', 'method = "jitty"', 21, "column.method is 'jitty'; did you mean 'jiti'?"),
        ('paper = "jiti"', 'paper = "ours"', 22, "column.paper is 'ours'"),
        ('name = "jiti"', 'name = "base"', 20, "two columns are called base"),
        ("seeds = [0, 1]", "seeds = [0, 0]", 17, "name different seeds"),
        ('second = "jiti"', 'second = "full"', 24, "compare is 'full'"),
        ('["elegant/T2"]', '["elegant/T3"]', 13, "groups.unseen is 'elegant/T3'"),
        ("episodes = 10", "seed = 99990", 5, "gives the seeds"),
        ('name = "base"', 'title = "base"', 15, "column lacks the key 'name'"),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path, old, new, line, said):
    text = GOOD.replace(old, new, 1)
    assert text != GOOD
    with pytest.raises(UsageError) as error:
        read_plan(write(tmp_path, text))
    assert said in str(error.value)
    assert f"own.toml, line {line}: " in str(error.value)


def test_what_is_no_plan_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"no-such cannot be read.*table8"):
        read_plan("no-such")
    with pytest.raises(UsageError, match="is no TOML"):
        read_plan(write(tmp_path, "tasks = ["))
    with pytest.raises(UsageError, match=r"needs a section \[data\]"):
        read_plan(write(tmp_path, 'title = "nothing"'))
