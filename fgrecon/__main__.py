"""`python -m fgrecon` is the command `fgrecon`."""

from fgrecon.cli.door import main

main()
