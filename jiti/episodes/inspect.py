"""What is in a source: episodes, streams, clocks, and the problems found."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jiti.episodes.episode import ChecksItself, Episode, EpisodeReader, EpisodeRef, Problem, Stream
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

SHOWN_EPISODES = 30
"""Rows of the episode table in a terminal; the JSON has all. Our choice: about one screen."""

SHOWN_PROBLEMS = 30
SHOWN_STREAM_SETS = 3


@dataclass(frozen=True, slots=True)
class EpisodeReport:
    """One episode. Without `streams`, it was listed but not opened, or could not be."""

    episode_id: str
    title: str
    task: str | None
    frame_count: int | None
    duration_s: float | None
    """From the first frame to the last."""
    clock_reference: str | None
    """The camera whose pictures are the frames; None for a fixed rate."""
    rate_hz: float | None
    fingerprint: str | None
    streams: tuple[Stream, ...]
    problems: tuple[Problem, ...]


@dataclass(frozen=True, slots=True)
class SourceReport:
    """A file, a folder or a dataset."""

    title: str
    labels_dir: str
    episodes: tuple[EpisodeReport, ...]
    problems: tuple[Problem, ...]
    """Of the source as a whole."""

    @property
    def readable(self) -> bool:
        """Whether an episode could be opened, or there is none to open."""
        return not self.episodes or any(episode.clock_reference or episode.rate_hz for episode in self.episodes)


def inspect_source(
    source: str | Path | None = None, *, limit: int | None = None, progress: Callable[[int, int], None] | None = None
) -> SourceReport:
    """Open a source and look at it. Raises SourceError when nothing of it can be read."""
    return inspect(open_reader(source), limit=limit, progress=progress)


def inspect(
    reader: EpisodeReader, *, limit: int | None = None, progress: Callable[[int, int], None] | None = None
) -> SourceReport:
    """Open the episodes of a source, the first `limit` of them, one after the other; the rest is only listed.

    An episode that cannot be opened is a problem in the report. `progress` is called with how many are done and how
    many there are.
    """
    refs = reader.episodes()
    reports = []
    for done, ref in enumerate(refs):
        if progress is not None:
            progress(done, len(refs))
        if limit is not None and done >= limit:
            reports.append(_listed(ref, (ref.problem,) if ref.problem else ()))
            continue
        try:
            reports.append(_opened(ref, reader.open(ref.episode_id)))
        except SourceError as error:
            problem = ref.problem or Problem(ref.title, str(error).rstrip("."), "The others can be used.", "error")
            reports.append(_listed(ref, (problem,)))
    if progress is not None:
        progress(len(refs), len(refs))
    return SourceReport(reader.title, str(reader.labels_dir), tuple(reports), tuple(reader.problems))


def to_json(report: SourceReport) -> dict[str, Any]:
    """The report as plain lists, dicts, numbers and texts; keys are the records' fields."""
    return asdict(report)


def print_report(report: SourceReport, console: "Console | None" = None, *, as_json: bool = False) -> None:
    """Print for a person, readable from 80 columns on, or as JSON for a script; to standard output by default."""
    if as_json:
        print(json.dumps(to_json(report), indent=2))
        return
    from rich.console import Console
    from rich.text import Text

    console = console or Console(highlight=False)
    console.print(Text(report.title, style="bold"))
    console.print(Text.assemble("labels  ", (report.labels_dir, "dim")), soft_wrap=True)
    if len(report.episodes) == 1:
        for line in _facts(report.episodes[0]):
            console.print(line)
    else:
        console.print(_episode_table(report))
        if len(report.episodes) > SHOWN_EPISODES:
            console.print(Text(f"... and {len(report.episodes) - SHOWN_EPISODES} more episodes; --json lists all"))
    _print_streams(report, console)
    _print_problems(report, console)


def _opened(ref: EpisodeRef, episode: Episode) -> EpisodeReport:
    clock = episode.clock
    problems = episode.check() if isinstance(episode, ChecksItself) else episode.problems
    return EpisodeReport(
        episode_id=ref.episode_id,
        title=ref.title,
        task=episode.task,
        frame_count=clock.frame_count,
        duration_s=clock.duration_ns / 1e9,
        clock_reference=clock.reference,
        rate_hz=clock.rate_hz,
        fingerprint=episode.fingerprint,
        streams=tuple(episode.streams.values()),
        problems=tuple(problems),
    )


def _listed(ref: EpisodeRef, problems: tuple[Problem, ...]) -> EpisodeReport:
    return EpisodeReport(ref.episode_id, ref.title, ref.task, ref.frame_count, None, None, None, None, (), problems)


def _facts(episode: EpisodeReport) -> Iterator[Any]:
    """Lines about a single episode."""
    from rich.text import Text

    if episode.task:
        yield Text.assemble("task    ", episode.task)
    if episode.frame_count is not None:
        rate = f" at {episode.rate_hz:.4g} Hz" if episode.rate_hz else ""
        span = f", {episode.duration_s:.2f} s" if episode.duration_s is not None else ""
        yield Text.assemble("frames  ", f"{episode.frame_count}{rate}{span}")
        if episode.streams:
            yield Text.assemble("clock   ", episode.clock_reference or "fixed rate (no camera)")


def _episode_table(report: SourceReport) -> "Table":
    from rich.text import Text

    table = _table()
    table.add_column("episode", overflow="fold", ratio=3)
    for name in ("frames", "s", "Hz"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("task", overflow="ellipsis", no_wrap=True, ratio=4)
    table.add_column("problems", justify="right", no_wrap=True)
    for episode in report.episodes[:SHOWN_EPISODES]:
        table.add_row(
            Text(episode.title),
            "" if episode.frame_count is None else str(episode.frame_count),
            "" if episode.duration_s is None else f"{episode.duration_s:.1f}",
            "" if episode.rate_hz is None else f"{episode.rate_hz:.4g}",
            Text(episode.task or ""),
            Text(str(len(episode.problems)), style="bold red") if episode.problems else Text(""),
        )
    return table


def _print_streams(report: SourceReport, console: "Console") -> None:
    """One table for each set of streams: those of its first episode, and how many have the same."""
    from rich.text import Text

    groups: dict[Any, list[EpisodeReport]] = {}
    for episode in report.episodes:
        if episode.streams:
            key = tuple((s.name, s.kind, s.shape, s.encoding) for s in episode.streams)
            groups.setdefault(key, []).append(episode)
    for group in sorted(groups.values(), key=len, reverse=True)[:SHOWN_STREAM_SETS]:
        console.print()
        if len(report.episodes) > 1:
            same = f", and of {len(group) - 1} more" if len(group) > 1 else ""
            console.print(Text(f"Streams of {group[0].title}{same}"))
        console.print(_stream_table(group[0]))
    if len(groups) > SHOWN_STREAM_SETS:
        console.print(Text(f"\n... and {len(groups) - SHOWN_STREAM_SETS} more sets of streams; --json lists all"))


def _stream_table(episode: EpisodeReport) -> "Table":
    from rich.text import Text

    table = _table()
    table.add_column("stream", overflow="fold")
    table.add_column("kind", no_wrap=True)
    for name in ("count", "Hz"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("shape", no_wrap=True)
    table.add_column("encoding", overflow="fold")
    for stream in episode.streams:
        style = "dim" if stream.kind == "other" else "bold" if stream.name == episode.clock_reference else ""
        table.add_row(
            Text(stream.name),
            stream.kind,
            str(stream.count),
            "" if stream.rate_hz is None else f"{stream.rate_hz:.4g}",
            "x".join(map(str, stream.shape)),
            Text(_encoding(stream)),
            style=style,
        )
    return table


def _table() -> "Table":
    from rich.table import Table

    return Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim", expand=False)


def _print_problems(report: SourceReport, console: "Console") -> None:
    from rich.text import Text

    problems = [*report.problems, *(problem for episode in report.episodes for problem in episode.problems)]
    console.print()
    if not problems:
        console.print(Text("No problems found.", style="green"))
        return
    console.print(Text(f"{len(problems)} problem{'s' if len(problems) != 1 else ''}", style="bold"))
    for problem in problems[:SHOWN_PROBLEMS]:
        style = "bold red" if problem.severity == "error" else "yellow"
        console.print(Text.assemble((f"{problem.severity}: ", style), str(problem)))
    if len(problems) > SHOWN_PROBLEMS:
        console.print(Text(f"... and {len(problems) - SHOWN_PROBLEMS} more; --json lists all"))


def _encoding(stream: Stream) -> str:
    """What a reader yields, and what the recording holds where that is something else; of a schema its last name."""
    if stream.schema.startswith("video/") and stream.schema != f"video/{stream.encoding}":
        return f"{stream.encoding} from {stream.schema.removeprefix('video/')}"
    return re.split(r"[/.]", stream.encoding)[-1]
