"""Entry point of the `fgrecon` command: registers the commands and turns errors into exit codes.

Exit codes: 0 success, 1 the work was done but failed (no car could be reconstructed), 2 bad usage or input,
130 interrupted.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from importlib import metadata
from io import TextIOWrapper
from typing import Annotated, TextIO

import typer

from fgrecon.cli import keypoints, prior, vehicles
from fgrecon.cli.app import app_command
from fgrecon.cli.batch import batch_command
from fgrecon.cli.calibrate import calibrate_command
from fgrecon.cli.commands import add_command, new_group
from fgrecon.cli.demo import demo_command
from fgrecon.cli.export import export_command
from fgrecon.cli.reconstruct import reconstruct_command
from fgrecon.cli.refine import refine_command
from fgrecon.cli.replay import replay_command
from fgrecon.cli.run import run_command
from fgrecon.cli.sample import sample_command
from fgrecon.cli.serve import serve_command
from fgrecon.cli.track import track_command
from fgrecon.core.errors import FgreconError
from fgrecon.core.text import printable

PLUGINS = "fgrecon.commands"
"""Entry points of this group are called with the command line's groups by name ('' is the root) and add commands."""

app = typer.Typer(
    name="fgrecon",
    help="Pose and shape of a vehicle from a single image, by factor-graph optimisation.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


add_command(app, "demo", demo_command)
add_command(app, "sample", sample_command)
add_command(app, "reconstruct", reconstruct_command)
add_command(app, "batch", batch_command)
add_command(app, "refine", refine_command)
add_command(app, "run", run_command, in_folder=("tracks.txt", "tracks.csv", "tracks.parquet", "frames.jsonl"))
add_command(app, "track", track_command)
add_command(app, "replay", replay_command)
add_command(app, "export", export_command)
add_command(app, "calibrate", calibrate_command)
add_command(app, "serve", serve_command)
add_command(app, "app", app_command)
evaluate = new_group(
    "evaluate",
    "Compare fgrecon with other methods on data with known poses.",
    ("boxes", "calibration", "icra2017", "kitti", "marks", "models", "paper", "refine", "shape", "tracks", "video"),
)
_GROUPS = {
    "evaluate": evaluate,
    "prior": prior.app,
    "keypoints": keypoints.app,
    "vehicles": vehicles.app,
}
for _name, _group in _GROUPS.items():
    app.add_typer(_group, name=_name)
for _plugin in metadata.entry_points(group=PLUGINS):
    _plugin.load()({"": app, **_GROUPS})


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"fgrecon {metadata.version('fgrecon')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Pose and shape of a vehicle from a single image, by factor-graph optimisation."""


def main() -> None:
    """Run the command line; bad input and files that cannot be used become one line and exit code 2."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that knows no ° shows a question mark
    try:
        try:
            app()
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()  # else Python would try at its end, and say it in its own words
    except FgreconError as error:
        _refuse(str(error))
    except OSError as error:
        full = error.filename is None and _takes_no_more(sys.stdout)
        if full and isinstance(error, BrokenPipeError):  # whoever reads has enough, as `head`
            sys.exit(1)
        name, fix = error.filename or "file", "Give a path that can be used."
        if full:
            name, fix = "standard output", "Send it where there is room."
        _refuse(f"{name}: {error.strerror or error}. {fix}")


def _refuse(message: str) -> None:
    try:
        print(f"fgrecon: {printable(message)}", file=sys.stderr)  # noqa: T201
    except OSError:  # the exit code says it
        _let_go(sys.stderr)
    sys.exit(2)


def _takes_no_more(stream: TextIO | None) -> bool:
    """Whether nothing more can be written there; what waits for it is thrown away then."""
    if stream is None:
        return False
    try:
        stream.write("\n")  # what failed need not be waiting any more
        stream.flush()
    except OSError:
        _let_go(stream)
        return True
    return False


def _let_go(stream: TextIO) -> None:
    """Throw away what waits: else Python tries it at its end, and exits with a code of its own."""
    with suppress(OSError):  # it may be none of the system's
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
