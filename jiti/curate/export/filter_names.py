"""Names in a filter: short ones of tasks made whole, unknown ones refused before a recording is opened, and the values
that episodes have where a filter leaves none."""

import ast
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jiti.curate.export.sources import Source
from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.tasks.catalogue import ids_named

SHOWN = 6
"""Values that are listed of a name. Our choice: a line."""


@dataclass(frozen=True, slots=True)
class Known:
    """Ids that episodes can have; those that labels name are the likeliest."""

    labelled_tasks: tuple[str, ...]
    tasks: tuple[str, ...]
    labelled_itcs: tuple[str, ...]
    itcs: tuple[str, ...]

    @classmethod
    def of(cls, sources: Sequence[Source]) -> "Known":
        rows = (row for source in sources for of_episode in source.counted.segments.values() for row in of_episode)
        labelled = dict.fromkeys(segment.itc_id for _, segment in rows)
        tasks = {task.task_id: task for source in sources for task in source.catalogue}
        return cls(
            tuple(sorted({itc_id.rpartition("/")[0] for itc_id in labelled} & tasks.keys())),
            tuple(tasks),
            tuple(sorted(labelled)),
            tuple(itc.itc_id for task in tasks.values() for itc in task.itcs),
        )


def complete(tree: ast.expr, known: Known, wrong: Callable[[ast.expr, str], UsageError]) -> None:
    """Put ids in the place of short names of tasks. Raises what `wrong` makes of a task or an ITC that no one knows."""
    for node in ast.walk(tree):
        match node:
            case ast.Subscript(slice=ast.Constant(value=str(name))):
                if not ids_named(name, (*known.labelled_itcs, *known.itcs)):
                    there = known.labelled_itcs or known.itcs
                    names = there if "/" in name else [itc_id.rpartition("/")[2] for itc_id in there]
                    raise wrong(node, f"there is no ITC {name!r}; {nearest(name, names)}")
            case ast.Compare():
                for text in _compared_with_task(node):
                    text.value = _task(text, known, wrong)


def _compared_with_task(node: ast.Compare) -> Iterator[ast.Constant]:
    """Texts in `task == 'T7'`, `'T7' == task` and `task in ('T2', 'T7')`."""
    left = node.left
    for op, right in zip(node.ops, node.comparators, strict=True):
        contains = isinstance(op, ast.In | ast.NotIn)
        for one, other in ((left, right), (right, left)):
            match one, other:
                case ast.Name(id="task"), ast.Constant(value=str()) if not contains:
                    yield other
                case ast.Name(id="task"), ast.Tuple(elts=parts) | ast.List(elts=parts) if contains:
                    yield from (
                        part for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)
                    )
        left = right


def _task(text: ast.Constant, known: Known, wrong: Callable[[ast.expr, str], UsageError]) -> str:
    name = str(text.value)
    found = ids_named(name, known.labelled_tasks) or ids_named(name, known.tasks)
    if len(found) > 1:
        raise wrong(text, f"{name!r} is the end of several tasks' ids: {', '.join(found)}")
    if not found:
        raise wrong(text, f"there is no task {name!r}; {nearest(name, known.labelled_tasks or known.tasks)}")
    return found[0]


def values_told(names: Sequence[str], episodes: Sequence[Mapping[str, Any]]) -> str:
    """What episodes have under names: `frames 150 to 420; reward 0 (40), 1 (40); itc['centered'] 1 (80)`."""
    return "; ".join(f"{name} {_values([_value(name, values) for values in episodes])}" for name in names)


def _value(name: str, values: Mapping[str, Any]) -> Any:
    if not name.startswith("itc["):
        return values[name]
    found = ids_named(ast.literal_eval(name[4:-1]), values["itc"])
    return values["itc"][found[0]] if found else None


def _values(values: Sequence[Any]) -> str:
    counts = Counter(values)
    told = [value for value in counts if value is not None]
    if len(told) > 2 and all(isinstance(value, int | float) for value in told):
        unknown = f", None ({counts[None]})" if None in counts else ""
        return f"{min(told):.6g} to {max(told):.6g}{unknown}"
    shown = [f"{value} ({count})" for value, count in sorted(counts.items(), key=lambda item: str(item[0]))]
    more = f" and {len(shown) - SHOWN} others" if len(shown) > SHOWN else ""
    return f"{', '.join(shown[:SHOWN])}{more}"
