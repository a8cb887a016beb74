"""`--print-features`: the automatic mapping as a file to begin from, and which recordings it does not fit."""

from collections.abc import Iterator, Mapping, Sequence

from jiti.curate.export.agree import size_of
from jiti.curate.export.automatic import map_automatically
from jiti.curate.export.features import Feature, Shape, shapes
from jiti.curate.export.features_file import features_toml
from jiti.curate.export.sources import Source
from jiti.episodes.episode import Episode
from jiti.errors import SourceError
from jiti.progress import Progress

Mapped = Mapping[str, tuple[Feature, Shape]]


def show_features(sources: Sequence[Source], progress: Progress = lambda _share, _what: None) -> str:
    """The mapping of the first recording that can be opened, with comments on those that others have. Raises
    SourceError where there is none."""
    total = max(1, sum(len(source.reader.episodes()) for source in sources))
    problem: SourceError | None = None
    first: tuple[str, Mapped] | None = None
    others: dict[str, list[str]] = {}
    for number, (title, episode) in enumerate(_opened(sources)):
        progress(number / total, title)
        if isinstance(episode, SourceError):
            problem = problem or episode
            continue
        try:
            features = map_automatically(episode, title)
            found = {
                f.key: (f, shape) for f, shape in zip(features, shapes(features, episode, title).values(), strict=True)
            }
        except SourceError as error:
            if first is None:
                raise
            others.setdefault(str(error).removeprefix(f"{title}: ").partition(". Say which")[0], []).append(title)
            continue
        if first is None:
            first = title, found
        elif told := "; ".join(_differences(first[1], found)):
            others.setdefault(told, []).append(title)
    if first is None:
        raise problem or SourceError("the sources have no episodes.")
    title, mapped = first
    comments = [f"# {_named(titles)}: {told}." for told, titles in others.items()]
    return features_toml([feature for feature, _ in mapped.values()], title, comments)


def _opened(sources: Sequence[Source]) -> Iterator[tuple[str, Episode | SourceError]]:
    for source in sources:
        for ref in source.reader.episodes():
            title = f"{source.name}, {ref.title}"
            try:
                yield title, source.reader.open(ref.episode_id)
            except SourceError as error:
                yield title, error


def _differences(first: Mapped, other: Mapped) -> Iterator[str]:
    for key in dict.fromkeys((*first, *other)):
        if key not in other:
            yield f"no {key!r}"
        elif key not in first:
            yield f"{key!r} besides, {_told(other[key])}"
        elif (here := _told(first[key])) != (there := _told(other[key])):
            yield f"{key!r} is {there}, not {here}"
        elif first[key][1].names != other[key][1].names:
            yield f"{key!r} has other components: {', '.join(other[key][1].names) or 'no names'}"


def _told(mapped: tuple[Feature, Shape]) -> str:
    feature, shape = mapped
    return f"{', '.join(feature.streams or filter(None, [feature.camera])) or 'the scene'} ({size_of(shape)})"


def _named(titles: Sequence[str]) -> str:
    return titles[0] if len(titles) == 1 else f"{titles[0]} and {len(titles) - 1} more"
