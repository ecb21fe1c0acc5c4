"""`fgrecon export`: results as files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output
from fgrecon.cli.terminal import Verbosity

__all__ = ["export_command"]


def export_command(
    results: Annotated[
        Path, typer.Argument(metavar="FILE.json", help="Results as written by --json of reconstruct or track, or demo.")
    ],
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="File to write: .ply, .glb, .csv, .parquet, or .txt for KITTI's lines."),
    ],
    terminal: Verbosity,
) -> None:
    """Write results for other programs; the ending of OUT chooses the kind of file.

    PLY and GLB: surfaces and wireframes in the camera frame. CSV and Parquet: one row per vehicle. TXT: KITTI's result
    lines, in the frame of KITTI's labels where the results know it. --verbose names the vehicles.
    """
    from fgrecon.io.export import export, read_results
    from fgrecon.io.export.files import check_format

    check_format(out)
    check_output(out)
    found = read_results(results)
    export(out, found)
    screen = terminal.screen()
    for vehicle in found:
        screen.detail(f"{vehicle.name}: {vehicle.result.status.value}")
    screen.print(f"{len(found)} vehicle{'s' * (len(found) != 1)}.")
    screen.wrote(out)
