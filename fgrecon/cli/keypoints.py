"""`fgrecon keypoints`: find keypoints in images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.common import (
    BoxesOption,
    BoxOption,
    DetectOption,
    JsonOption,
    WeightsOption,
    check_outputs,
    chosen_boxes,
    console,
    write_json,
)

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.perception.keypoints.detect import CascadeDetection

__all__ = ["app"]

app = typer.Typer(help="Find keypoints in images.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Find keypoints in images."""


@app.command("detect")
def detect_command(
    image: Annotated[Path, typer.Argument(help="Image file.")],
    box: BoxOption = None,
    boxes: BoxesOption = None,
    detect: DetectOption = False,
    weights: WeightsOption = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw what was found (png, jpg).")] = None,
    json_out: JsonOption = None,
) -> None:
    """Find the keypoints of cars. The JSON is what `fgrecon reconstruct` reads; confidences are probabilities."""
    from fgrecon.io.catalogue import load_category
    from fgrecon.io.images import read_image
    from fgrecon.perception.keypoints.detect import KeypointCascade

    check_outputs(json_out, picture)
    pixels = read_image(image)
    named = chosen_boxes(image, pixels, box, boxes, detect=detect)
    names = [item.name for item in named]
    category = load_category("car14")
    found = KeypointCascade(weights)(pixels, [item.corners for item in named])
    if json_out != "-":
        _print_found(names, found, category.keypoints)
    if json_out is not None:
        instances = [_instance(name, d) for name, d in zip(names, found, strict=True)]
        text = json.dumps({"instances": instances}, indent=1) + "\n"
        write_json(json_out, text)
    if picture is not None:
        from fgrecon.viz.detections import detection_sheet
        from fgrecon.viz.picture import save_picture

        save_picture(picture, detection_sheet(pixels, found, names, category))


def _instance(name: str, detection: CascadeDetection) -> dict[str, Any]:
    """A vehicle as the keypoint file has it, with what `reconstruct` does not read beside it."""
    seen = detection.observation
    return {
        "id": name,
        "keypoints": seen.keypoints.tolist(),
        "confidence": seen.confidence.tolist(),
        "confidence_midpoint": seen.confidence_midpoint,
        "covariance": None if seen.covariance is None else seen.covariance.tolist(),
        "box": None if seen.box is None else seen.box.tolist(),
        "visible": detection.visible.tolist(),
        "azimuth": detection.azimuth.tolist(),
    }


def _print_found(names: list[str], found: list[CascadeDetection], keypoints: tuple[str, ...]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("id", "keypoint", "u", "v", "confidence"):
        table.add_column(heading, justify="left" if heading in ("id", "keypoint") else "right")
    for name, detection in zip(names, found, strict=True):
        seen = detection.observation
        for keypoint, (u, v), sure in zip(keypoints, seen.keypoints, seen.confidence, strict=True):
            table.add_row(name, keypoint, f"{u:.1f}", f"{v:.1f}", f"{sure:.2f}")
    console(error=False).print(table)
