"""`fgrecon vehicles convert`: the car detector's file from the ones that its authors published."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output, console

__all__ = ["convert_command"]


def convert_command(
    cfg: Annotated[Path, typer.Option(help="yolov4-tiny.cfg of Darknet.")],
    weights: Annotated[Path, typer.Option(help="yolov4-tiny.weights of Darknet.")],
    out: Annotated[Path, typer.Option(help="ONNX file to write.")],
) -> None:
    """Make the detector's file from Darknet's two. Needs the package `onnx`."""
    from fgrecon.training.keypoints.darknet import convert

    check_output(out)
    console(error=False).print(f"Wrote {convert(cfg, weights, out)}.", markup=False)
