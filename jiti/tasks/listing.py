"""Tasks and their ITCs for a person."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from jiti.tasks.task import Task

if TYPE_CHECKING:
    from rich.console import Console


def print_tasks(tasks: Iterable[Task], console: "Console") -> None:
    """One block a task: its id and instruction, then each ITC with how it is decided."""
    from rich.padding import Padding
    from rich.text import Text

    for task in tasks:
        console.print(Text.assemble((task.task_id, "bold"), f"  {task.instruction}"))
        for itc in task.itcs:
            criterion = str(itc.criterion).replace("_", " ")
            console.print(
                Padding(Text.assemble((itc.itc_id, "cyan"), f" ({criterion}): {itc.statement}"), (0, 0, 0, 2))
            )
            if itc.check:
                console.print(Padding(Text(itc.check, style="dim"), (0, 0, 0, 4)))
