"""Command line of fgrecon: one module per command, registered in `fgrecon.cli.main`.

What cannot be used is refused by an `InvalidInputError` everywhere here, which `fgrecon.cli.main` makes exit code 2 of.
"""
