"""`fgrecon vehicles`: find cars in images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.commands import add_command, new_group
from fgrecon.cli.terminal import Terminal
from fgrecon.core.text import counted

app = new_group("vehicles", "Find cars in images.", ("convert",))


def detect_command(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE", help="Image files.")],
    terminal: Terminal,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write.", show_default="the output")] = None,
) -> None:
    """Find cars. The lines, `image class score x1 y1 x2 y2 detected`, are what --boxes of other commands reads.

    It takes those with a score from 0.5, and what the boxes enclose from the last word. --verbose says how
    many cars each image has.

    Exit code 1: no car in any image.
    """
    from fgrecon.core.choices import BoxModel
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.io.files import check_output
    from fgrecon.io.images import read_image
    from fgrecon.perception.vehicles import NanodetVehicleDetector

    check_output(out)
    named: dict[str, Path] = {}
    for path in images:  # lines name images, and those that read them go by the name without its ending
        if (other := named.setdefault(path.stem, path)) != path:
            fix = f"Rename it, or look at it in another run: {other} has the same name."
            raise InvalidInputError("images", str(path), fix)
    screen = terminal.screen(error=out is None)
    detector = NanodetVehicleDetector()
    lines: list[str] = []
    for path in screen.watch(images, "Images"):
        found = detector(read_image(path))
        screen.detail(f"{path}: {counted(len(found.boxes), 'car')}")
        for box, score in zip(found.boxes, found.scores, strict=True):
            corners = " ".join(f"{number:.2f}" for number in box)
            lines.append(f"{path.name} 2 {score:.3f} {corners} {BoxModel.DETECTED}\n")
    if out is None:
        screen.write_output("out", "".join(lines))
    else:
        screen.write_text(out, "".join(lines))
    if not lines:
        screen.fail("No car was found.")
        raise typer.Exit(1)


add_command(app, "detect", detect_command)
