"""The `jiti` command. Each subcommand parses, imports what it needs, calls one function and prints."""

import sys

from jiti.cli.app import app
from jiti.errors import JitiError

# They add their commands to `app`, in the order in which its help has them.
# isort: off
from jiti.cli import labels, datasets, runs, chains  # noqa: F401
# isort: on

__all__ = ["app", "main"]


def main() -> None:
    """Run the command line; a JitiError becomes one message and exit code 1."""
    try:
        app()
    except JitiError as error:
        print(f"jiti: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
