"""The `jiti` command. Each subcommand parses, imports what it needs, calls one function and prints."""

import sys

import typer

from jiti.errors import JitiError

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Label how robot demonstrations were done.")


def main() -> None:
    """Run the command line; a JitiError becomes one message and exit code 1."""
    try:
        app()
    except JitiError as error:
        print(f"jiti: {error}", file=sys.stderr)
        sys.exit(1)
