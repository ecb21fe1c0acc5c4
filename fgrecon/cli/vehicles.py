"""`fgrecon vehicles`: find cars in images."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output, console

__all__ = ["app"]

app = typer.Typer(help="Find cars in images.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Find cars in images."""


@app.command("detect")
def detect_command(
    images: Annotated[list[Path], typer.Argument(help="Image files.")],
    out: Annotated[Path | None, typer.Option(help="File to write.", show_default="the output")] = None,
) -> None:
    """Find cars. The lines, `image class score x1 y1 x2 y2`, are what --boxes of other commands reads (score from 0.5).

    Its boxes enclose the outline: give --box-model surface beside them, where --detect knows.

    Exit code 1: no car in any image.
    """
    from fgrecon.io.files import write_text
    from fgrecon.io.images import read_image
    from fgrecon.perception.vehicles import YoloVehicleDetector

    check_output(out)
    detector = YoloVehicleDetector()
    lines = []
    for path in images:
        found = detector(read_image(path))
        for box, score in zip(found.boxes, found.scores, strict=True):
            lines.append(f"{path.name} 2 {score:.3f} {' '.join(f'{number:.2f}' for number in box)}\n")
    if out is None:
        sys.stdout.write("".join(lines))
    else:
        write_text(out, "".join(lines))
    if not lines:
        console(error=True).print("No car was found.")
        raise typer.Exit(1)
