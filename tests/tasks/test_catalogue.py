"""The package's catalogue says what the paper says; instructions find their task."""

import json
import tomllib
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.errors import CatalogueError
from jiti.tasks.catalogue import Catalogue, load_catalogue, print_catalogue
from jiti.tasks.task import Criterion

CATALOGUE = load_catalogue()


def table(supplement: str, number: int, columns: int) -> list[list[str]]:
    """Rows of a table of the supplement, with that many columns."""
    body = supplement[supplement.index(f"Table {number}. ") :]
    rows = [line.split("\t") for line in body.splitlines()[1:60]]
    wanted = {4: "Task ", 6: ("Seen-", "Unseen-"), 7: "Task "}[number]
    found = [row for row in rows if row[0].startswith(wanted) and len(row) == columns and row[0] != "Task ID"]
    return found[: {4: 8, 6: 7, 7: 6}[number]]


@pytest.fixture(scope="module")
def supplement(shared: Path) -> str:
    return (shared / "paper" / "beyond-success-supplement.txt").read_text()


def criterion_named(name: str) -> Criterion:
    return Criterion(name.lower().replace(" ", "_").replace("-", "_"))


@pytest.mark.parametrize(("number", "prefix", "count"), [(4, "elegant", 8), (7, "so100", 6)])
def test_tables_4_and_7_are_there_word_for_word(supplement: str, number: int, prefix: str, count: int) -> None:
    rows = table(supplement, number, 4)
    assert len(rows) == count
    for name, instruction, statement, criterion in rows:
        task = CATALOGUE.task(f"{prefix}/T{name.removeprefix('Task ')}")
        assert task.instruction == instruction
        assert [(itc.statement, itc.criterion) for itc in task.itcs] == [(statement, criterion_named(criterion))]
        assert task.source == f"supplement, Table {number}"


def test_table_6_is_there_word_for_word(supplement: str) -> None:
    rows = table(supplement, 6, 4)
    assert len(rows) == 7
    for category, _, instruction, criterion in rows:
        name, letter = category.split("-")
        task = CATALOGUE.task(f"rq3/{name.lower()}-{letter}")
        assert task.instruction == instruction
        assert [itc.criterion for itc in task.itcs] == [criterion_named(criterion)]


def test_simulated_tasks_name_the_bddl_files_of_the_paper(shared: Path) -> None:
    facts = (shared / "paper" / "FACTS.md").read_text()
    for number in range(8):
        line = next(line for line in facts.splitlines() if line.startswith(f"- T{number} "))
        assert CATALOGUE.task(f"elegant/T{number}").bddl == line.split("`")[1]
    named = {task.bddl for task in CATALOGUE if task.task_id.startswith("g4/")}
    assert {bddl for bddl in named if bddl and bddl.startswith("libero_90")} == {
        "libero_90/KITCHEN_SCENE1_put_the_black_bowl_on_the_plate",
        "libero_90/KITCHEN_SCENE4_close_the_bottom_drawer_of_the_cabinet",
        "libero_90/KITCHEN_SCENE10_close_the_top_drawer_of_the_cabinet",
        "libero_90/KITCHEN_SCENE6_close_the_microwave",
    }
    assert all(task.bddl for task in CATALOGUE if not task.task_id.startswith("so100/"))


def test_ids_are_unique_and_everything_can_be_decided() -> None:
    assert len(CATALOGUE) == 27
    assert max(Counter(task.task_id for task in CATALOGUE).values()) == 1
    itcs = [itc for task in CATALOGUE for itc in task.itcs]
    assert max(Counter(itc.itc_id for itc in itcs).values()) == 1
    for task in CATALOGUE:
        for itc in task.itcs:
            assert itc.itc_id.startswith(f"{task.task_id}/")
            assert "Pass: " in itc.check
            assert "Fail: " in itc.check
            assert CATALOGUE.itc(itc.itc_id) == itc
    assert {itc.criterion for itc in itcs} == set(Criterion)


@pytest.mark.parametrize(
    ("instruction", "task_id"),
    [
        ("put the bowl on the plate", "elegant/T2"),
        ("Put the bowl on the plate.", "elegant/T2"),
        ("  put\tthe  bowl\non the\u00a0plate ", "elegant/T2"),
        ("put_the_bowl_on_the_plate", "elegant/T2"),
        ("Put-the-bowl, on the plate!", "elegant/T2"),
        ("Pick the ketchup and place it in the basket", "elegant/T0"),
        ("PICK UP THE bbq SAUCE AND PLACE IT IN THE BASKET", "rq3/unseen-B"),
        ("KITCHEN_SCENE6_close_the_microwave", "g4/close-microwave"),
        ("stack the red squares on top of the green ones", "so100/T2"),
    ],
)
def test_instructions_find_their_task_however_they_are_written(instruction: str, task_id: str) -> None:
    task = CATALOGUE.match(instruction)
    assert task is not None
    assert task.task_id == task_id


@pytest.mark.parametrize("instruction", [None, "", " ", "...", "put the bowl", "put the bowl on the plates"])
def test_other_instructions_find_none(instruction: str | None) -> None:
    assert CATALOGUE.match(instruction) is None


@settings(deadline=None)
@given(st.none() | st.text())
def test_every_episode_can_be_labelled(instruction: str | None) -> None:
    task = CATALOGUE.for_instruction(instruction)
    if CATALOGUE.match(instruction) is None:
        assert [itc.itc_id for itc in task.itcs] == [f"generic/{criterion}" for criterion in Criterion]
        assert task.instruction == (instruction or "")
        assert all(CATALOGUE.itc(itc.itc_id) == itc for itc in task.itcs)
        assert CATALOGUE.task("generic").itcs == task.itcs


def test_an_unknown_id_is_answered_with_the_nearest() -> None:
    with pytest.raises(CatalogueError, match=r"there is no task 'elegant/T9'; did you mean elegant/T\d"):
        CATALOGUE.task("elegant/T9")
    assert CATALOGUE.itc("elegant/T9/none") is None


USER = """
[[task]]
id = "{task_id}"
instruction = "put the bowl on the plate"
{more}
[[task.itc]]
id = "gently"
criterion = "pose_alignment"
statement = "No sound."
"""


def test_a_user_task_is_matched_before_ours(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(USER.format(task_id="lab/bowl", more=""))
    catalogue = load_catalogue(file)
    assert len(catalogue) == 28
    task = catalogue.match("put the bowl on the plate")
    assert task is not None
    assert task == catalogue.task("lab/bowl") == next(iter(catalogue))
    assert (task.source, task.itcs[0].itc_id, task.itcs[0].check) == ("lab.toml", "lab/bowl/gently", "")
    assert isinstance(catalogue, Catalogue)


def test_a_user_task_takes_the_place_of_ours_only_when_it_says_so(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(USER.format(task_id="elegant/T2", more=""))
    with pytest.raises(CatalogueError, match=r"lab\.toml, line 2: the task id 'elegant/T2' is one of the package's"):
        load_catalogue(file)
    file.write_text(USER.format(task_id="elegant/T2", more="replace = true"))
    catalogue = load_catalogue(file)
    assert len(catalogue) == 27
    assert catalogue.task("elegant/T2").itcs[0].statement == "No sound."
    assert load_catalogue().task("elegant/T2") == CATALOGUE.task("elegant/T2")


def test_two_files_cannot_define_one_task(tmp_path: Path) -> None:
    for name in ("a.toml", "b.toml"):
        (tmp_path / name).write_text(USER.format(task_id="lab/bowl", more="replace = true"))
    with pytest.raises(CatalogueError, match=r"b\.toml, line 2: the task id 'lab/bowl' is taken by .*a\.toml, line 2"):
        load_catalogue(tmp_path / "a.toml", tmp_path / "b.toml")


def test_the_listing_has_every_task_and_itc(capsys: pytest.CaptureFixture[str]) -> None:
    print_catalogue(CATALOGUE, as_json=True)
    listed = json.loads(capsys.readouterr().out)
    assert [task["task_id"] for task in listed] == [task.task_id for task in CATALOGUE]
    assert listed[2]["itcs"][0]["criterion"] == "target_pose_accuracy"
    print_catalogue(CATALOGUE)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 54
    assert lines[4] == "elegant/T2  put the bowl on the plate"
    assert lines[5].startswith("    centered (target pose accuracy): The bowl must be placed precisely")


def test_the_files_are_plain_toml_for_everyone() -> None:
    folder = Path(__file__).parents[2] / "jiti" / "tasks" / "catalogue"
    assert sum(len(tomllib.loads(path.read_text())["task"]) for path in folder.glob("*.toml")) == 27
