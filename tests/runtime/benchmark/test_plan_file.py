"""A plan is read as it is written, and every mistake in it is told with its line."""

from dataclasses import replace
from pathlib import Path

import pytest

from jiti.errors import UsageError
from jiti.runtime.benchmark.command import Request, resolved
from jiti.runtime.benchmark.plan import smaller
from jiti.runtime.benchmark.plan_file import read_plan, shipped_plans
from jiti.tasks.catalogue import Catalogue, load_catalogue

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
TASKS = """\
[[task]]
id = "own/blind"
instruction = "do it with care"
bddl = "libero_goal/put_the_bowl_on_the_plate"

[[task.itc]]
id = "careful"
criterion = "pose_alignment"
statement = "With care."
check = "Look."
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
        ("episodes = 10", "disturbance = 2", 5, "data.disturbance is 2; it must be from 0 to 1"),
        ("[critic]", "[critics]", 7, "a plan has no 'critics'; did you mean 'critic'?"),
        ('tasks = ["elegant/T0"]', 'tasks = ["elegant/T1"]', 8, "critic.tasks is 'elegant/T1'; did you mean"),
        ('method = "jiti"', 'method = "jitty"', 21, "column.method is 'jitty'; did you mean 'jiti'?"),
        ('paper = "jiti"', 'paper = "ours"', 22, "column.paper is 'ours'"),
        ('name = "jiti"', 'name = "base"', 20, "two columns are called base"),
        ("seeds = [0, 1]", "seeds = [0, 0]", 17, "name different seeds"),
        ('second = "jiti"', 'second = "full"', 26, "compare.second is 'full'"),
        ('["elegant/T2"]', '["elegant/T3"]', 13, "groups.unseen is 'elegant/T3'"),
        ("episodes = 10", "seed = 99990", 5, "gives the seeds"),
        ('name = "base"', 'title = "base"', 15, "column lacks the key 'name'"),
        ('title = "two"', "title = 2", 1, "title is 2; it must be a text"),
        (
            "[critic]",
            '[critic]\nrecipe = "stat"',
            8,
            "critic.recipe is 'stat', which is no file; did you mean 'state'?",
        ),
        ("alpha = 0.5", "alpah = 0.5", 10, "[loss] has no key 'alpah'; did you mean 'alpha'?"),
        ("alpha = 0.5", 'alpha = "half"', 10, "loss.alpha is 'half'; it must be a number"),
        ("settings.loss", "settings.los", 9, "there is no section [los]; did you mean 'loss'?"),
        ("episodes = 10", "[curate]\ngamma = 3.0", 6, "curate.gamma is 3.0; it must be from 0 to 1"),
        ("episodes = 10", '[curate]\nsplit = "hello"', 6, "curate.split is 'hello'; it must be three shares"),
        ('"elegant/T2"]\nepisodes', '"elegant/T0"]\nepisodes', 4, "data.tasks names elegant/T0 twice"),
        ('unseen = ["elegant/T2"]', 'un-seen = ["elegant/T9"]', 13, "groups.un-seen is 'elegant/T9'"),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path, old, new, line, said):
    text = GOOD.replace(old, new, 1)
    assert text != GOOD
    with pytest.raises(UsageError) as error:
        read_plan(write(tmp_path, text))
    assert said in str(error.value)
    assert f"own.toml, line {line}: " in str(error.value)


def test_groups_that_are_no_section_are_refused(tmp_path):
    text = GOOD.replace('[groups]\nunseen = ["elegant/T2"]\n', "")
    with pytest.raises(UsageError, match=r"own\.toml, line 2: groups is 5; it must be a section"):
        read_plan(write(tmp_path, text.replace('title = "two"\n', 'title = "two"\ngroups = 5\n')))


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ("elegant/T77", r"'elegant/T77' is no task of simulation; did you mean 'elegant/T7'\?.*--task-file FILE adds"),
        ("so100/T4", "'so100/T4' is no task of simulation"),
        ("own/blind", "own/blind/careful has no `goal`"),
    ],
)
def test_a_task_that_cannot_be_played_is_told_with_its_line(tmp_path, task, said):
    own = tmp_path / "tasks.toml"
    own.write_text(TASKS)
    path = write(tmp_path, GOOD.replace('"elegant/T2"]\nepisodes', f'"elegant/T2", "{task}"]\nepisodes'))
    with pytest.raises(UsageError, match=rf"own\.toml, line 4: {said}"):
        read_plan(path, load_catalogue(own))


def test_a_task_of_which_nothing_is_judged_is_told_with_its_line(tmp_path):
    tasks = tuple(replace(task, itcs=()) if task.task_id == "elegant/T2" else task for task in load_catalogue())
    with pytest.raises(UsageError, match=r"own\.toml, line 4: elegant/T2 has no ITC.*pass that with --task-file"):
        read_plan(write(tmp_path, GOOD), Catalogue(tasks))


def test_settings_of_a_file_that_cannot_be_read_are_told_with_the_line_of_the_plan(tmp_path):
    recipe = tmp_path / "critic.toml"
    path = write(tmp_path, GOOD.replace("[critic]", f'[critic]\nrecipe = "{recipe}"'))
    recipe.write_text("[loss")
    with pytest.raises(UsageError, match=rf"own\.toml, line 8: critic\.recipe {recipe} is no TOML"):
        read_plan(path)
    recipe.write_text("[loss]\nalpha = 2.0\n")
    assert read_plan(path).critic.recipe == str(recipe)


def test_what_is_no_plan_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"no-such cannot be read.*table8"):
        read_plan("no-such")
    with pytest.raises(UsageError, match="is no TOML"):
        read_plan(write(tmp_path, "tasks = ["))
    with pytest.raises(UsageError, match=r"needs a section \[data\]"):
        read_plan(write(tmp_path, 'title = "nothing"'))


def test_a_quick_run_is_of_the_task_that_was_asked_for():
    assert resolved(Request(quick=True, tasks=("T2",)), load_catalogue()).tasks == ("elegant/T2",)
    assert resolved(Request(quick=True), load_catalogue()).tasks == ("elegant/T0",)
    with pytest.raises(UsageError, match="--tasks rq3/seen-A: the plan plays elegant/T0, elegant/T1"):
        resolved(Request(quick=True, tasks=("rq3/seen-A",)), load_catalogue())
