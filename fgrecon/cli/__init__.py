"""Command line of fgrecon: one module per command, registered in `fgrecon.cli.main`."""
