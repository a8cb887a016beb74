"""What recordings must share to be one dataset: a rate, and the size and names of every feature."""

from collections.abc import Sequence

from jiti.curate.export.features import Shape
from jiti.curate.export.frames import whole_rate
from jiti.curate.export.planned import Opened
from jiti.errors import SourceError, UsageError


def common_rate(found: Sequence[Opened]) -> int:
    """Frames a second of all recordings. Raises UsageError where they differ."""
    rates: dict[int, str] = {}
    for opened in found:
        rates.setdefault(whole_rate(opened.rate_hz, opened.title), opened.title)
    if len(rates) > 1:
        (one, there), (other, here) = list(rates.items())[:2]
        raise UsageError(
            f"the recordings have different rates: {there} runs at {one} Hz, {here} at {other} Hz. "
            f"Pass --fps {min(rates)} to resample all of them, or curate them apart."
        )
    return next(iter(rates))


def check_shapes(found: Sequence[Opened]) -> None:
    """Raises SourceError where two recordings disagree on a feature."""
    expected, one = found[0].shapes, found[0].title
    remedy = "Map them alike with --features (--print-features shows a mapping to begin from), or curate them apart."
    for opened in found[1:]:
        shape, other = opened.shapes, opened.title
        if lacking := [key for key in (*expected, *shape) if (key in expected) != (key in shape)]:
            has, has_not = (one, other) if lacking[0] in expected else (other, one)
            raise SourceError(f"{has} has {lacking[0]!r}, and {has_not} has not. {remedy}")
        for key, there in shape.items():
            if there.shape != expected[key].shape:
                raise SourceError(
                    f"{key!r} is {size_of(expected[key])} in {one}, and {size_of(there)} in {other}. {remedy}"
                )
            if there.names and expected[key].names and there.names != expected[key].names:
                pairs = enumerate(zip(expected[key].names, there.names, strict=True))
                place, (name, name_there) = next((k, pair) for k, pair in pairs if pair[0] != pair[1])
                raise SourceError(
                    f"number {place} of {key!r} is {name!r} in {one}, and {name_there!r} in {other}. {remedy}"
                )


def size_of(shape: Shape) -> str:
    """`8 numbers`, `64x48 pixels`."""
    if shape.dtype == "video":
        return f"{shape.shape[1]}x{shape.shape[0]} pixels"
    return f"{shape.shape[0]} numbers"
