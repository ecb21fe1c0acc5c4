"""`fgrecon vehicles convert`: the car detector's file from the ones that its authors published."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output
from fgrecon.cli.terminal import Quiet

__all__ = ["convert_command"]


def convert_command(
    cfg: Annotated[Path, typer.Option(metavar="FILE", help="yolov4-tiny.cfg of Darknet.")],
    weights: Annotated[Path, typer.Option(metavar="FILE", help="yolov4-tiny.weights of Darknet.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="ONNX file to write.")],
    terminal: Quiet,
) -> None:
    r"""Make the detector's file from Darknet's two. Needs the packages of fgrecon\[training]."""
    from fgrecon.training.keypoints.darknet import convert

    check_output(out)
    terminal.screen().wrote(convert(cfg, weights, out))
