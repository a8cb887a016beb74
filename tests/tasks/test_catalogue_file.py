"""Mistakes in a task file are answered with their line and what to write instead."""

from pathlib import Path

import pytest

from jiti.errors import CatalogueError
from jiti.tasks.catalogue_file import read_tasks

GOOD = """\
[[task]]
id = "lab/pour"
instruction = "pour the water into the glass"
aliases = ["pour water"]

[[task.itc]]
id = "nothing-spilled"
criterion = "task_sequence_integrity"
statement = "No water may land outside the glass."

[[task]]
id = "lab/wipe"
instruction = "wipe the table"
itc = [
    { id = "all", criterion = "target_pose_accuracy", statement = "The cloth reaches every corner." },
    { id = "dry", criterion = "pose_alignment", statement = "Nothing stays wet." },
]
"""


def mistakes(folder: Path, text: str | bytes) -> list[str]:
    """What is said about a file, without its path."""
    path = folder / "lab.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(CatalogueError) as error:
        read_tasks(path)
    lines = str(error.value).splitlines()
    assert all(line.startswith(f"{path}, line ") for line in lines)
    return [line.removeprefix(f"{path}, ") for line in lines]


def test_a_good_file_gives_tasks_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(GOOD)
    pour, wipe = read_tasks(path)
    assert (pour.line, wipe.line, pour.replace) == (1, 11, False)
    assert pour.task.aliases == ("pour water",)
    assert [itc.itc_id for itc in wipe.task.itcs] == ["lab/wipe/all", "lab/wipe/dry"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            'instruction = "pour',
            'instructon = "pour',
            [
                "line 1: a task has no instruction; add `instruction = ...`",
                "line 3: a task has no key 'instructon'; did you mean 'instruction'? There are: "
                "id, instruction, itc, aliases, source, bddl, replace",
            ],
        ),
        (
            'criterion = "task_sequence_integrity"',
            'criterion = "sequence_integrity"',
            [
                "line 8: there is no criterion 'sequence_integrity'; did you mean 'task_sequence_integrity'? There "
                "are: task_sequence_integrity, target_pose_accuracy, pose_alignment, collision_free_execution"
            ],
        ),
        (
            'statement = "No water',
            'statment = "No water',
            [
                "line 6: an ITC has no statement; add `statement = ...`",
                "line 9: an ITC has no key 'statment'; did you mean 'statement'? There are: "
                "id, criterion, statement, check, goal",
            ],
        ),
        ('id = "lab/pour"', "id = 7", ["line 2: id is 7; it must be a text"]),
        ('id = "lab/pour"', 'id = ""', ["line 2: id is ''; it must not be empty"]),
        ('["pour water"]', '"pour water"', ["line 4: aliases is 'pour water'; it must be a list of texts"]),
        ('["pour water"]', "[1]", ["line 4: aliases is [1]; it must be a list of texts"]),
        ('id = "lab/wipe"', 'id = "lab/pour"', ["line 11: the task id 'lab/pour' is taken by the task in line 1"]),
        ('id = "dry"', 'id = "all"', ["line 14: the task has two ITCs with the id 'all'"]),
        (
            'id = "lab/pour"',
            'id = "lab/po ur"',
            [
                "line 2: the task id is 'lab/po ur'; it must be letters, digits and . _ - in parts that '/' divides, "
                "and not start with 'generic'"
            ],
        ),
        (
            'id = "lab/pour"',
            'id = "generic/x"',
            [
                "line 2: the task id is 'generic/x'; it must be letters, digits and . _ - in parts that '/' divides, "
                "and not start with 'generic'"
            ],
        ),
        (
            'id = "nothing-spilled"',
            'id = "nothing/spilled"',
            ["line 7: the ITC id is 'nothing/spilled'; it must be letters, digits and . _ -"],
        ),
        ("[[task.itc]]", "[[task.itcs]]", None),
        ('id = "lab/pour"', 'id = "lab/pour"\nreplace = "yes"', ["line 3: replace is 'yes'; it must be true or false"]),
    ],
)
def test_each_mistake_names_its_line(tmp_path: Path, old: str, new: str, expected: list[str] | None) -> None:
    assert GOOD.count(old) == 1
    found = mistakes(tmp_path, GOOD.replace(old, new))
    if expected is None:
        assert found == [
            "line 1: a task has no itc; add [[task.itc]]",
            "line 6: a task has no key 'itcs'; did you mean 'itc'? There are: "
            "id, instruction, itc, aliases, source, bddl, replace",
        ]
    else:
        assert found == expected


def test_all_mistakes_are_told_at_once_in_the_order_of_lines(tmp_path: Path) -> None:
    text = GOOD.replace("pose_alignment", "pose").replace("lab/pour", "lab pour").replace('"No water', '"" # "No water')
    assert [line.partition(":")[0] for line in mistakes(tmp_path, f"title = 1\n{text}")] == [
        "line 1",
        "line 3",
        "line 10",
        "line 15",
    ]


def test_syntax_errors_name_line_and_column(tmp_path: Path) -> None:
    assert mistakes(tmp_path, GOOD.replace('id = "lab/pour"', "id = lab/pour")) == [
        "line 2: invalid value in column 6; this is not valid TOML"
    ]
    [message] = mistakes(tmp_path, GOOD + 'x = "no end')
    assert message.startswith("line 18: ")
    assert message.endswith("this is not valid TOML")
    [message] = mistakes(tmp_path, GOOD.replace("]]\nid", "]]\nid = 1\nid", 1))
    assert message.startswith("line 3: cannot overwrite a value")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "line 1: the file has no task; add [[task]]"),
        ("task = 3", "line 1: task is 3; it must be tables"),
        ("\ntask = [3]", "line 2: a task is 3; it must be a table"),
        (
            '[[task]]\nid = "a"\ninstruction = "b"\nitc = []',
            "line 4: the task has no ITC; give it at least one [[task.itc]]",
        ),
        ('[[task]]\nid = "a"\ninstruction = "b"\n\nitc = [\n3]', "line 5: an ITC is 3; it must be a table"),
        (b'[[task]]\n\nid = "\xff"', "line 3: this is not UTF-8 text; save the file as UTF-8"),
    ],
)
def test_files_that_are_no_catalogue(tmp_path: Path, text: str | bytes, expected: str) -> None:
    assert mistakes(tmp_path, text) == [expected]


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match=r"none\.toml cannot be read as a task file: no such file or directory"):
        read_tasks(tmp_path / "none.toml")
    with pytest.raises(CatalogueError, match="cannot be read as a task file: is a directory"):
        read_tasks(tmp_path)
