"""The `jiti` command. Each subcommand parses, imports what it needs, calls one function and prints."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from jiti import __version__
from jiti.errors import JitiError, UsageError

if TYPE_CHECKING:
    from jiti.annotate.web.session import Session

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # with Rich the help takes five times as long to appear
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Label how robot demonstrations were done, and learn from those labels.",
)

Source = Annotated[
    str | None,
    typer.Argument(help="An MCAP file, a folder of them, a LeRobot folder or Hub id. Default: the current folder."),
]
Tasks = Annotated[
    list[Path] | None,
    typer.Option("--tasks", help="A TOML file with your tasks and ITCs; may be repeated. Default: tasks.toml there."),
]
Labels = Annotated[Path | None, typer.Option("--labels", help="Folder of the labels. Default: beside the recordings.")]
Annotator = Annotated[str | None, typer.Option("--annotator", help="Who labels. Default: your login name.")]
Port = Annotated[
    int, typer.Option("--port", min=0, max=65535, show_default=False, help="Port on 127.0.0.1. Default: any free one.")
]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for scripts.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"jiti {__version__}")
        raise typer.Exit


@app.callback()
def about(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Label how robot demonstrations were done, and learn from those labels."""


@app.command(short_help="Mark segments and verdicts in a browser (ESA).")
def annotate(
    source: Source = None,
    annotator: Annotator = None,
    labels: Labels = None,
    tasks: Tasks = None,
    port: Port = 0,
    no_browser: NoBrowser = False,
) -> None:
    """Open the Elegance Segment Annotator (ESA) in a browser.

    Example: jiti annotate episode.mcap
    """
    from jiti.annotate.web.serve import serve
    from jiti.annotate.web.session import open_session

    session = open_session(source, annotator=annotator, labels=labels, tasks=tasks)
    _say_session(session)
    serve(session, port=port, browser=not no_browser)


@app.command("validate-rewards", short_help="Show rewards and returns, find mistakes (RVV).")
def validate_rewards(
    source: Source = None,
    annotator: Annotator = None,
    labels: Labels = None,
    tasks: Tasks = None,
    port: Port = 0,
    no_browser: NoBrowser = False,
    check: Annotated[
        bool, typer.Option("--check", help="List mistakes in the terminal; exit code 1 when there are errors.")
    ] = False,
    agreement: Annotated[
        tuple[str, str] | None, typer.Option("--agreement", metavar="A B", help="Compare two annotators.")
    ] = None,
    write: Annotated[bool, typer.Option("--write", help="Write rewards and returns to rewards.parquet.")] = False,
    gamma: Annotated[float, typer.Option("--gamma", min=0.0, max=1.0, help="Discount of the return.")] = 0.98,
    as_json: Json = False,
) -> None:
    """Open the Reward Validation Viewer (RVV), or check labels in the terminal.

    Example: jiti validate-rewards --check
    """
    from jiti.annotate.web.session import open_session

    if sum((check, write, agreement is not None)) > 1:
        raise UsageError("--check, --write and --agreement A B are three commands: pass one of them.")
    if as_json and not (check or agreement):
        raise UsageError("--json needs --check or --agreement A B.")
    if labels is not None and not labels.exists() and (check or write or agreement):
        raise UsageError(f"--labels {labels} does not exist: there is nothing to check.")
    session = open_session(source, annotator=annotator, labels=labels, tasks=tasks)
    if agreement:
        from jiti.annotate.agreement import compare_labels, print_agreement

        print_agreement(compare_labels(session.store.labels_dir, *agreement), as_json=as_json)
    elif write:
        from jiti.curate.rewards_file import write_rewards

        print(f"Wrote {write_rewards(session.store.labels_dir, gamma=gamma)}.")
    elif check:
        from jiti.curate.validate import check_labels, print_check

        with _progress("Opening recordings") as progress:
            found = check_labels(session, gamma=gamma, progress=progress)
        print_check(found, as_json=as_json)
        raise typer.Exit(1 if found.errors else 0)
    else:
        from jiti.annotate.web.serve import serve
        from jiti.curate.rvv import rvv_routes

        _say_session(session)
        serve(session, path=f"/rewards?gamma={gamma:g}", port=port, browser=not no_browser, routes=rvv_routes(session))


@app.command(short_help="List episodes, streams and problems.")
def inspect(source: Source = None, as_json: Json = False) -> None:
    """List the episodes of a source, their streams, and what is wrong with them. Exits with 1 when none can be opened.

    Example: jiti inspect episode.mcap --json
    """
    from jiti.episodes.inspect import inspect_source, print_report

    with _progress("Reading") as progress:
        report = inspect_source(source, progress=lambda done, total: progress(done / max(1, total), "Reading"))
    print_report(report, as_json=as_json)
    if not report.readable:
        raise typer.Exit(1)


@app.command(short_help="List tasks and their constraints (ITCs).")
def tasks(tasks: Tasks = None, as_json: Json = False) -> None:
    """List the tasks and their Implicit Task Constraints (ITCs).

    Example: jiti tasks --tasks mine.toml
    """
    from jiti.tasks.catalogue import load_catalogue, print_catalogue

    print_catalogue(load_catalogue(*tasks or ()), as_json=as_json)


@app.command(short_help="Record a scripted pick, then annotate it.")
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder of the recordings.")] = Path("jiti-demo"),
    episodes: Annotated[int, typer.Option("--episodes", min=1, help="Episodes to record.")] = 1,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the first episode.")] = 0,
    headless: Annotated[bool, typer.Option("--headless", help="End after writing and checking.")] = False,
    port: Port = 0,
    no_browser: NoBrowser = False,
) -> None:
    """Record a scripted pick in simulation, propose segments, open ESA on it.

    Example: jiti demo --headless
    """
    from jiti.runtime.sim.demo import demo as run_demo

    with _progress("Recording") as progress:
        summary = run_demo(out, episodes=episodes, seed=seed, progress=progress)
    print(summary)
    if not headless:
        annotate(str(out), port=port, no_browser=no_browser)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[float, str], None]]:
    """A progress bar on a terminal, nothing elsewhere; called with the share that is done and what is being done."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share, now: bar.update(task, completed=share, description=now)


def _say_session(session: "Session") -> None:
    print(f"{session.reader.title}. Labels of {session.annotator} go to {session.store.labels_dir}.")


def main() -> None:
    """Run the command line; a JitiError becomes one message and exit code 1."""
    try:
        app()
    except JitiError as error:
        print(f"jiti: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
