"""`fgrecon keypoints`: find keypoints in images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.commands import add_command, new_group
from fgrecon.cli.options import JsonOption, VehicleBoxes
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal, headed_table

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from rich.table import Table

    from fgrecon.perception.keypoints.detect import CascadeDetection

_NOTHING = 0.005  # confidence that two decimals show as none

app = new_group("keypoints", "Find keypoints in images.", ("evaluate", "label", "silhouettes", "train"))


def detect_command(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="Image file.")],
    boxes: VehicleBoxes,
    terminal: Terminal,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the keypoints (png, jpg).")] = None,
    json_out: JsonOption = None,
) -> None:
    """Find the keypoints of cars. The JSON is what `fgrecon reconstruct` reads; confidences are probabilities.

    --verbose also has how exact each position is and how probably the keypoint can be seen.
    """
    from fgrecon.batch.vehicle_tasks import KeypointRequest, detect_in_boxes
    from fgrecon.io.catalogue import load_category
    from fgrecon.io.images import read_image

    check_outputs(json_out, picture=picture)
    screen = terminal.screen(json_out)
    pixels = read_image(image)
    named = boxes.source().of_image(image, pixels).cars
    names = [item.name for item in named]
    category = load_category("car14")
    found = detect_in_boxes(pixels, named, KeypointRequest(category, boxes.weights), screen.watch)
    screen.print(_table(names, found, category.keypoints, verbose=screen.verbose))
    instances = [
        _instance(item.name, d) | {n: v for n in ("kind", "score", "track") if (v := getattr(item, n)) is not None}
        for item, d in zip(named, found, strict=True)
    ]
    screen.write_document({"instances": instances})
    if picture is not None:
        from fgrecon.viz.detections import detection_sheet
        from fgrecon.viz.picture import save_picture

        screen.wrote(save_picture(picture, detection_sheet(pixels, found, names, category)))


def _instance(name: str, detection: CascadeDetection) -> dict[str, Any]:
    """A vehicle as the keypoint file has it, with what `reconstruct` does not read beside it."""
    observation = detection.observation
    return {
        "id": name,
        "keypoints": observation.keypoints.tolist(),
        "confidence": observation.confidence.tolist(),
        "confidence_midpoint": observation.confidence_midpoint,
        "covariance": None if observation.covariance is None else observation.covariance.tolist(),
        "box": None if observation.box is None else observation.box.tolist(),
        "visible": detection.visible.tolist(),
        "azimuth": detection.azimuth.tolist(),
        "front_probability": detection.front_probability,
        "left_probability": detection.left_probability,
    }


def _table(names: list[str], found: list[CascadeDetection], keypoints: tuple[str, ...], *, verbose: bool) -> Table:
    import numpy as np

    headings = ("id", "keypoint", "u", "v", "confidence", *(("sigma px", "visible") if verbose else ()))
    table = headed_table(*headings, left=2)
    for name, detection in zip(names, found, strict=True):
        observation = detection.observation
        covariance = (
            np.full((len(keypoints), 2, 2), np.nan) if observation.covariance is None else observation.covariance
        )
        sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2.0)
        for k, keypoint in enumerate(keypoints):
            u, v = observation.keypoints[k]
            if observation.confidence[k] < _NOTHING:  # where it is guessed to be says nothing
                table.add_row(
                    name, keypoint, "", "", "hidden", *(("", f"{detection.visible[k]:.2f}") if verbose else ())
                )
                continue
            cells = [f"{u:.1f}", f"{v:.1f}", f"{observation.confidence[k]:.2f}"]
            cells += [f"{sigma[k]:.1f}", f"{detection.visible[k]:.2f}"] if verbose else []
            table.add_row(name, keypoint, *cells)
    return table


add_command(app, "detect", detect_command)
