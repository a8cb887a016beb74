"""What satisfies an ITC, in BDDL: predicates on the state of a scene, and when in an episode they must hold.

    (Until (IsGrasping ketchup_1) (IsOnBottomOf ketchup_1 basket_1))

LIBERO's goals speak of the last state only; an ITC often speaks of the whole motion. So around LIBERO's and the paper's
predicates (supplement B.2) there are four words of ours:

    (AtEnd P)       P holds at the last step; a bare P means the same
    (AtRelease P)   P holds at the last step before the hand lets go of P's first argument
    (Until G P)     G, once true, stays true to a step at which P is true too; there it may end, the first time it does
    (Always P ...)  all of them hold at every step
    (And W ...)     all of these
"""

from collections.abc import Iterator
from dataclasses import dataclass

from jiti.errors import CatalogueError

GRASP = "IsGrasping"


@dataclass(frozen=True, slots=True)
class Atom:
    """One predicate of named things, with its tolerance where the goal gives one."""

    predicate: str
    arguments: tuple[str, ...]
    tolerance: float | None = None
    """In the unit of the predicate; None for the predicate's own."""

    def __str__(self) -> str:
        numbers = () if self.tolerance is None else (f"{self.tolerance:g}",)
        return " ".join((self.predicate, *self.arguments, *numbers))

    @property
    def grasp(self) -> "Atom":
        """Whether the hand holds what this is about."""
        return Atom(GRASP, self.arguments[:1])


@dataclass(frozen=True, slots=True)
class AtEnd:
    what: Atom


@dataclass(frozen=True, slots=True)
class AtRelease:
    what: Atom


@dataclass(frozen=True, slots=True)
class Until:
    stays: Atom
    until: Atom


@dataclass(frozen=True, slots=True)
class Always:
    what: tuple[Atom, ...]


@dataclass(frozen=True, slots=True)
class And:
    parts: tuple["Goal", ...]


type Goal = AtEnd | AtRelease | Until | Always | And

_WORDS = ("AtEnd", "AtRelease", "Until", "Always", "And")


def parse_goal(text: str) -> Goal:
    """Raises CatalogueError that says what is wrong in the text."""
    tokens = text.replace("(", " ( ").replace(")", " ) ").split()
    tree, rest = _tree(tokens, text)
    if rest:
        raise CatalogueError(f"after the goal there is {' '.join(rest)!r}; close it with one ')' at the end")
    return _goal(tree)


def atoms(goal: Goal) -> tuple[Atom, ...]:
    """Every predicate that a goal needs to be watched, once, in its order; grasps where a release is looked for."""
    return tuple(dict.fromkeys(_atoms(goal)))


def _atoms(goal: Goal) -> Iterator[Atom]:
    match goal:
        case And(parts):
            for part in parts:
                yield from _atoms(part)
        case Always(what):
            yield from what
        case Until(stays, until):
            yield from (stays, until)
        case AtRelease(what):
            yield from (what, what.grasp)
        case AtEnd(what):
            yield what


type _Tree = list["str | _Tree"]


def _tree(tokens: list[str], text: str) -> tuple[_Tree, list[str]]:
    if not tokens or tokens[0] != "(":
        raise CatalogueError(f"a goal starts with '(', as in (AtEnd (On bowl_1 plate_1)); this is {text.strip()!r}")
    tree: _Tree = []
    rest = tokens[1:]
    while rest and rest[0] != ")":
        if rest[0] == "(":
            inner, rest = _tree(rest, text)
            tree.append(inner)
        else:
            tree.append(rest[0])
            rest = rest[1:]
    if not rest:
        raise CatalogueError(f"a ')' is missing at the end of {text.strip()!r}")
    return tree, rest[1:]


def _goal(tree: _Tree) -> Goal:
    word, *inner = tree or [""]
    if word == "And":
        return And(tuple(_goal(_inner(part, "And")) for part in _some(inner, "And")))
    if word == "Always":
        return Always(tuple(_atom(_inner(part, "Always")) for part in _some(inner, "Always")))
    if word == "Until":
        return Until(*(_atom(_inner(part, "Until")) for part in _exactly(inner, "Until", 2)))
    if word in ("AtEnd", "AtRelease"):
        (part,) = _exactly(inner, word, 1)
        return (AtEnd if word == "AtEnd" else AtRelease)(_atom(_inner(part, word)))
    return AtEnd(_atom(tree))


def _atom(tree: _Tree) -> Atom:
    words = [word for word in tree if isinstance(word, str)]
    if len(words) < 2 or len(words) < len(tree) or words[0] in _WORDS:
        raise CatalogueError(f"{_shown(tree)} is no predicate of named things, as (On bowl_1 plate_1) is")
    try:
        tolerance = float(words[-1])
    except ValueError:
        return Atom(words[0], tuple(words[1:]))
    if len(words) < 3 or not tolerance > 0:
        raise CatalogueError(f"{_shown(tree)} has no thing that it speaks of, or a tolerance that is not over 0")
    return Atom(words[0], tuple(words[1:-1]), tolerance)


def _inner(part: "str | _Tree", word: str) -> _Tree:
    if isinstance(part, str):
        raise CatalogueError(f"({word} ...) holds {part!r}; put it in brackets, as in ({word} (On bowl_1 plate_1))")
    return part


def _some(inner: _Tree, word: str) -> _Tree:
    if not inner:
        raise CatalogueError(f"({word}) is empty; it takes one predicate or more")
    return inner


def _exactly(inner: _Tree, word: str, count: int) -> _Tree:
    if len(inner) != count:
        raise CatalogueError(f"({word} ...) holds {len(inner)} things; it takes {count}")
    return inner


def _shown(tree: "str | _Tree") -> str:
    return tree if isinstance(tree, str) else f"({' '.join(_shown(part) for part in tree)})"
