"""How a name that no one knows is answered: with the known name that was probably meant, and all that there are."""

from collections.abc import Iterable
from difflib import get_close_matches


def nearest(name: object, known: Iterable[str]) -> str:
    """The end of a message: `did you mean 'alpha'? There are: alpha, beta`, or `there are: ...` where none is like it.

    Whatever the case of either.
    """
    by_lower = {str(one).lower(): str(one) for one in known}
    close = get_close_matches(str(name).lower(), by_lower, 1)
    there = f"here are: {', '.join(by_lower.values())}"
    return f"did you mean {by_lower[close[0]]!r}? T{there}" if close else f"t{there}"
