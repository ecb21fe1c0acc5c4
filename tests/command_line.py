"""The command line as users call it."""

from typer.testing import CliRunner

from fgrecon.cli import main


def run(*arguments):
    """What a command does: its output and exit code; paths and numbers are taken as text."""
    return CliRunner().invoke(main.app, [*map(str, arguments)])
