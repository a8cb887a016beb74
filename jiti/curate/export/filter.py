"""`--filter 'reward == 1 and frames < 400'`: a small grammar over the values of an episode, read with Python's parser.

Nothing is evaluated but comparisons, `and`, `or`, `not`, `in`, numbers, texts, names, and `itc['id']`.
"""

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from jiti.curate.export.filter_names import Known, complete
from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.tasks.catalogue import ids_named

Values = Mapping[str, Any]
"""Values of one episode by name; None for what is not known, and `itc` a mapping of verdicts by id."""

NAMES = {
    "episode": "id of the episode in its source",
    "source": "name of the source",
    "task": "id of the task, None without one; compared with 'T7', the only one whose id ends in /T7",
    "instruction": "instruction of the task",
    "frames": "frames",
    "seconds": "duration",
    "segments": "segments that count",
    "annotators": "who made them, with commas between",
    "annotated": "share of annotated frames, 0 to 1",
    "reward": "1 where every segment is satisfied, 0 where one is violated, None without any",
    "return": "Monte-Carlo return at the first frame",
    "peak_return": "highest Monte-Carlo return",
    "success": "whether the task's own condition was met, None where the recording does not say",
    "split": "train, validation, test or unseen",
    "itc": "verdicts by id, 0 or 1: itc['elegant/T2/centered'], or the id's last part where that is enough",
}
"""What a filter can ask for."""

_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
    ast.Is: operator.eq,
    ast.IsNot: operator.ne,
}
_ORDER = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)


class Filter:
    """A condition on episodes."""

    def __init__(self, text: str) -> None:
        """Raises UsageError that names the place and, for an unknown name, those that there are."""
        self.text = text
        try:
            self._tree = ast.parse(_with_names(text), mode="eval").body
        except (SyntaxError, ValueError, RecursionError) as error:
            where = f", column {error.offset}" if isinstance(error, SyntaxError) and error.offset else ""
            reason = error.msg if isinstance(error, SyntaxError) else str(error)
            raise UsageError(
                f"--filter {text!r}{where}: {reason}. Write a condition like \"reward == 1 and task == 'elegant/T2'\"."
            ) from error
        self._check(self._tree)

    def __call__(self, values: Values) -> bool:
        """Whether an episode is kept. An order with what is not known is false. Raises UsageError."""
        return bool(self._value(self._tree, values))

    @property
    def names(self) -> list[str]:
        """What it asks for, in order: `frames`, `itc['centered']`."""
        found = []
        for node in ast.walk(self._tree):
            match node:
                case ast.Name(id=name) if name != "itc":
                    found.append((node.col_offset, _plain(name)))
                case ast.Subscript(slice=ast.Constant(value=str(name))):
                    found.append((node.col_offset, f"itc[{name!r}]"))
        return list(dict.fromkeys(name for _, name in sorted(found)))

    def completed(self, known: Known) -> "Filter":
        """The same with ids for short names of tasks. Raises UsageError for a task or an ITC that no one knows."""
        other = Filter(self.text)
        complete(other._tree, known, other._wrong)
        return other

    def _check(self, node: ast.expr) -> None:
        match node:
            case ast.BoolOp(values=parts) | ast.Tuple(elts=parts) | ast.List(elts=parts):
                for part in parts:
                    self._check(part)
            case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
                self._check(operand)
            case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARE for op in ops):
                for part in (left, *others):
                    self._check(part)
            case ast.Constant(value=bool() | int() | float() | str() | None):
                pass
            case ast.Name(id=name):
                if _plain(name) == "itc":
                    raise self._wrong(node, "itc takes an id: itc['elegant/T2/centered']")
                if _plain(name) not in NAMES:
                    raise self._wrong(node, f"there is no {_plain(name)!r}; {nearest(_plain(name), NAMES)}")
            case ast.Subscript(value=ast.Name(id="itc"), slice=ast.Constant(value=str())):
                pass
            case _:
                raise self._wrong(node, "only comparisons, and, or, not, in, numbers, texts and names can be used")

    def _value(self, node: ast.expr, values: Values) -> Any:
        match node:
            case ast.BoolOp(op=ast.And(), values=parts):
                return all(self._value(part, values) for part in parts)
            case ast.BoolOp(values=parts):
                return any(self._value(part, values) for part in parts)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return not self._value(operand, values)
            case ast.UnaryOp(operand=operand):
                return self._try(node, operator.neg, self._value(operand, values))
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compare(node, left, ops, others, values)
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                return values[_plain(name)]
            case ast.Subscript(slice=ast.Constant(value=str(name))):
                return self._verdict(node, name, values["itc"])
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                return [self._value(part, values) for part in parts]
        raise self._wrong(node, "this cannot be worked out")

    def _compare(
        self, node: ast.expr, left: ast.expr, ops: list[ast.cmpop], others: list[ast.expr], values: Values
    ) -> bool:
        here = self._value(left, values)
        for op, other in zip(ops, others, strict=True):
            there = self._value(other, values)
            if isinstance(op, _ORDER) and (here is None or there is None):
                return False
            if not self._try(node, _COMPARE[type(op)], here, there):
                return False
            here = there
        return True

    def _verdict(self, node: ast.expr, name: str, verdicts: Mapping[str, int]) -> int | None:
        found = ids_named(name, verdicts)
        if len(found) > 1:
            raise self._wrong(node, f"{name!r} is the end of several ITCs: {', '.join(found)}")
        return verdicts[found[0]] if found else None

    def _try(self, node: ast.expr, do: Callable[..., Any], *operands: Any) -> Any:
        try:
            return do(*operands)
        except TypeError:
            kinds = " and ".join("nothing" if one is None else type(one).__name__ for one in operands)
            raise self._wrong(node, f"{kinds} cannot be compared") from None

    def _wrong(self, node: ast.expr, what: str) -> UsageError:
        return UsageError(f"--filter {self.text!r}, column {node.col_offset + 1}: {what}.")


_RETURN, _STAND_IN = "return", "ret_rn"
"""A name of a filter that is a keyword of Python, and what stands for it: as long, so that columns stay right."""


def _with_names(text: str) -> str:
    """The text with `return` as a name that Python's parser takes; texts in quotes stay as they are."""
    parts, quote, word = [], "", ""
    for character in text + "\0":
        if not quote and (character.isalnum() or character == "_"):
            word += character
            continue
        parts.append(_STAND_IN if word == _RETURN else word)
        word = ""
        quote = "" if character == quote else (character if not quote and character in "'\"" else quote)
        parts.append(character)
    return "".join(parts).removesuffix("\0").strip()


def _plain(name: str) -> str:
    return _RETURN if name == _STAND_IN else name
