"""`python -m jiti` is `jiti`."""

from jiti.cli import main

main()
