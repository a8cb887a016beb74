"""The `jiti` command itself."""

from typing import Annotated

import typer

from jiti import __version__

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # with Rich the help takes five times as long to appear
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Label how robot demonstrations were done, and learn from those labels.",
)


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
