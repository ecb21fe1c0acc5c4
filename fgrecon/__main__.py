"""`python -m fgrecon` is the command `fgrecon`."""

from fgrecon.cli.main import main

main()
