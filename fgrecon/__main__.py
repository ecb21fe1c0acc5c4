"""`python -m fgrecon` is the command `fgrecon`."""

from fgrecon.cli.entry import run

run()
