"""Lines of tables and keys in TOML documents."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.tasks.toml_lines import KeyPath, line_numbers, line_of

DOCUMENT = '''# a comment with [brackets] and "quotes
title = "a # no comment, no ] bracket"

[[task]]                      # 4
id = "a"
text = """
[[task]]
id = "not a key"
\\"""" # 9
list = [                      # 10
    "x", # ]
    [1, 2],
    { id = "inline", more = [3] },
]
'quoted key' = 1              # 15
"also.quoted" = \'\'\'
it''s
\'\'\'
a.b.c = 1                     # 19

  [[task.itc]]                # 21
  id = "one"
  [[ task . itc ]]            # 23
  id = "two"

  [task.itc.more]             # 26
  deep = true
[[task]]                      # 28
[[task.itc]]
id = "three"
[other."x y".z]               # 31
k = 1'''


def test_every_table_and_key_has_its_line() -> None:
    tomllib.loads(DOCUMENT)
    assert line_numbers(DOCUMENT) == {
        ("title",): 2,
        ("task", 0): 4,
        ("task", 0, "id"): 5,
        ("task", 0, "text"): 6,
        ("task", 0, "list"): 10,
        ("task", 0, "quoted key"): 15,
        ("task", 0, "also.quoted"): 16,
        ("task", 0, "a"): 19,
        ("task", 0, "a", "b"): 19,
        ("task", 0, "a", "b", "c"): 19,
        ("task", 0, "itc", 0): 21,
        ("task", 0, "itc", 0, "id"): 22,
        ("task", 0, "itc", 1): 23,
        ("task", 0, "itc", 1, "id"): 24,
        ("task", 0, "itc", 1, "more"): 26,
        ("task", 0, "itc", 1, "more", "deep"): 27,
        ("task", 1): 28,
        ("task", 1, "itc", 0): 29,
        ("task", 1, "itc", 0, "id"): 30,
        ("other", "x y", "z"): 31,
        ("other", "x y", "z", "k"): 32,
    }


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("task", 0, "list", 2, "id"), 10),
        (("task", 0, "itc", 1, "missing"), 23),
        (("task", 5), 4),
        (("task", 0, "itc"), 21),
        ((), 1),
    ],
)
def test_what_has_no_line_stands_where_its_holder_does(path: KeyPath, line: int) -> None:
    assert line_of(line_numbers(DOCUMENT), path) == line


values = st.sampled_from(
    [
        "1",
        '"x # y"',
        "'[ \"'",
        "[1,\n  2, # ]\n]",
        '"""\na = 1\n[t]\n"""',
        "'''\n\\'''",
        '{ a = "]" }',
        '"\\\\"',
        '"""\\""""',
    ]
)
"""Values that try to look like something else."""


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2), st.booleans(), st.lists(values, max_size=4)), max_size=8))
def test_any_document_agrees_with_where_it_was_written(parts: list[tuple[int, bool, list[str]]]) -> None:
    text = ""
    expected: dict[KeyPath, int] = {}
    tasks = itcs = 0
    for blank_lines, inner, entries in parts:
        text += "# [[task]]\n" * blank_lines
        line = text.count("\n") + 1
        if inner and tasks:
            path: KeyPath = ("task", tasks - 1, "itc", itcs)
            itcs += 1
            text += "[[task.itc]]\n"
        else:
            path = ("task", tasks)
            tasks, itcs = tasks + 1, 0
            text += "[[task]]\n"
        expected[path] = line
        for number, value in enumerate(entries):
            expected[(*path, f"k{number}")] = text.count("\n") + 1
            text += f"k{number} = {value}\n"
    tomllib.loads(text)
    assert line_numbers(text) == expected
