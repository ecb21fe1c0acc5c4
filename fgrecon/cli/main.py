"""Entry point of the `fgrecon` command: registers the commands and turns errors into exit codes.

Exit codes: 0 success, 1 the work was done but failed (no car could be reconstructed), 2 bad usage or input,
130 interrupted.
"""

from __future__ import annotations

import sys

import typer

from fgrecon.cli import evaluate, prior
from fgrecon.errors import FgreconError

__all__ = ["app", "main"]

app = typer.Typer(
    name="fgrecon",
    help="Pose and shape of a vehicle from a single image, by factor-graph optimisation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


app.add_typer(evaluate.app, name="evaluate")
app.add_typer(prior.app, name="prior")


@app.callback()
def _root() -> None:
    """Pose and shape of a vehicle from a single image, by factor-graph optimisation."""


def main() -> None:
    """Run the command line; errors that fgrecon raises on purpose become one line and exit code 2."""
    try:
        app()
    except FgreconError as error:
        print(f"fgrecon: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(2)
