"""`fgrecon export`: results as files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["export_command"]


def export_command(
    results: Annotated[Path, typer.Argument(help="Results as written by --json of reconstruct or track, or by demo.")],
    out: Annotated[Path, typer.Argument(help="File to write: .ply, .glb, .csv, .parquet, or .txt for KITTI's lines.")],
) -> None:
    """Write results for other programs; the ending of OUT chooses the kind of file.

    PLY and GLB: surfaces and wireframes in the camera frame. CSV and Parquet: one row per vehicle. TXT: KITTI's result
    lines, in the frame of KITTI's labels where the results know it.
    """
    from fgrecon.cli.common import check_output, console
    from fgrecon.io.export import export, read_results
    from fgrecon.io.export.files import check_format

    check_format(out)
    check_output(out)
    found = read_results(results)
    export(out, found)
    console(error=False).print(f"{len(found)} vehicle{'s' * (len(found) != 1)} to {out}", markup=False)
