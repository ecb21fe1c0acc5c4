"""`fgrecon evaluate kitti`: from KITTI's photographs to poses, scored by regime."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import GroundOption, JsonOption, PriorOption, check_outputs, console, ground_plane, write_json
from fgrecon.cli.deliver import (
    ConnectOption,
    SaveOption,
    SpawnOption,
    check_delivery,
    deliver,
    recordings_of,
    wants_recording,
)
from fgrecon.core.options import BoxModel

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.evaluation.kitti_images import Car
    from fgrecon.viz import Sight

__all__ = ["kitti_command"]

_CAMERA_HEIGHT = 1.65  # of KITTI's cameras above the road, metres


def kitti_command(
    images: Annotated[Path, typer.Option(help="Folder of images (training/image_2).")],
    labels: Annotated[Path, typer.Option(help="Folder of label files (training/label_2).")],
    calib: Annotated[Path, typer.Option(help="Folder of calibration files (training/calib).")],
    split: Annotated[Path | None, typer.Option(help="File of frame names.", show_default="all images")] = None,
    boxes: Annotated[
        Path | None,
        typer.Option(help="2D detections, lines `image class score x1 y1 x2 y2`.", show_default="the labelled boxes"),
    ] = None,
    overlap: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Overlap with the labelled box that a detected one must exceed.")
    ] = 0.7,
    prior: PriorOption = "car14",
    size_prior: Annotated[str, typer.Option(help="Fleet, or none.")] = "kitti",
    camera_height: Annotated[
        float | None, typer.Option(help="Height of a level camera above the road, m.", show_default=str(_CAMERA_HEIGHT))
    ] = None,
    ground: GroundOption = None,
    box_model: Annotated[BoxModel, typer.Option(help="What the 2D boxes enclose.")] = BoxModel.CUBOID,
    weights: Annotated[Path | None, typer.Option(help="Network.", show_default="the shipped one")] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Contact sheet of every car.")] = None,
    save: SaveOption = None,
    connect: ConnectOption = None,
    spawn: SpawnOption = False,
    json_out: JsonOption = None,
) -> None:
    """Find keypoints in KITTI's images, reconstruct every labelled car, and score orientation and translation.

    Regimes are cumulative; a car without a detection or a result counts as 180 degrees and stays in.

    Exit code 1: no car could be reconstructed.
    """
    import json

    from fgrecon.core.camera import Ground
    from fgrecon.core.options import Options
    from fgrecon.core.size_prior import size_prior as parse_size
    from fgrecon.evaluation import kitti_images
    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.kitti_files import read_image_set
    from fgrecon.perception.keypoints.detect import KeypointCascade

    check_outputs(json_out, picture)
    check_delivery(save, connect)
    plane, origin = ground_plane(ground, camera_height) or (Ground.level(_CAMERA_HEIGHT), "level camera (KITTI's)")
    names = None if split is None else read_image_set(split)
    frames, problems = kitti_images.read_frames(images, labels, calib, names, boxes)
    setup = kitti_images.Setup(
        detector=KeypointCascade(weights),
        prior=load_prior(prior),
        ground=plane,
        size_prior=None if size_prior == "none" else parse_size(size_prior),
        options=Options(box=box_model),
        overlap=overlap,
    )
    cars = [car for frame in frames for car in kitti_images.score_frame(frame, setup)]

    out = console(error=json_out == "-")
    out.print(f"{len(frames)} images, {len(cars)} cars, {'detected' if boxes else 'labelled'} boxes; {origin}.")
    _print(cars, error=json_out == "-")
    for problem in problems:
        out.print(str(problem), markup=False)
    if json_out is not None:
        given = {
            "images": len(frames),
            "boxes": "labels" if boxes is None else boxes.name,
            "overlap": overlap,
            "ground": origin,
            "size_prior": size_prior,
            "box_model": box_model.value,
            "network": setup.detector.provenance,
        }
        text = json.dumps(kitti_images.document(cars, given), indent=1) + "\n"
        write_json(json_out, text)
    wanted = wants_recording(save, connect, spawn=spawn)
    sights = _sights(cars, {frame.name: frame.image for frame in frames}) if picture is not None or wanted else []
    if picture is not None and sights:
        from fgrecon.viz import contact_sheet, save_picture

        save_picture(picture, contact_sheet(sights, columns=5))
    if wanted:
        deliver(recordings_of(sights, plane), save, connect, spawn=spawn, several=True)
    if not any(car.failure is None for car in cars):
        raise typer.Exit(1)


def _print(cars: list[Car], *, error: bool) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from fgrecon.core.metrics import THRESHOLDS
    from fgrecon.evaluation.kitti_images import summarise

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    headings = [*(f"AOP {threshold}°" for threshold in THRESHOLDS), "mean °", "median °", "median m", "failed"]
    for heading in ("regime", "cars", *headings):
        table.add_column(heading, justify="left" if heading == "regime" else "right")
    for score in summarise(cars):
        shares = [f"{100 * count / score.cars:.1f} ({count})" for count in score.within]
        numbers = [f"{score.mean_degrees:.1f}", f"{score.median_degrees:.1f}", f"{score.median_metres:.2f}"]
        table.add_row(score.name, str(score.cars), *shares, *numbers, str(score.failures))
    console(error=error).print(table)


def _sights(cars: list[Car], images: dict[str, Path]) -> list[Sight]:
    """Every car with a result, with its photograph and the labelled box."""
    from fgrecon.io.images import read_image
    from fgrecon.simulation.vehicles import yaw_pose
    from fgrecon.viz import Sight
    from fgrecon.viz.truth import Truth

    photographs = {name: read_image(images[name]) for name in {car.frame for car in cars}}
    return [
        Sight(
            car.found.result,
            car.found.detection.observation,
            car.camera,
            photographs[car.frame],
            Truth(yaw_pose(car.rotation_y, car.location), car.size),
            f"{car.frame}/{car.index}",
        )
        for car in cars
        if car.found is not None and car.found.result is not None
    ]
