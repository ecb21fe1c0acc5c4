"""`fgrecon refine`: better 3D boxes of another detector, by the keypoints of the vehicles in them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.commands import option
from fgrecon.cli.options import (
    BOX_MODEL_HELP,
    BoxErrorOptions,
    CameraOptions,
    JsonOption,
    SceneOptions,
    WeightsOption,
)
from fgrecon.cli.outputs import check_not_over, check_outputs, files_in
from fgrecon.cli.sensor_options import SensorOptions
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel, BoxOrigin


@dataclass(frozen=True)
class RefineOptions:
    """How the boxes are refined."""

    camera: CameraOptions
    scene: SceneOptions
    errors: BoxErrorOptions
    sensors: SensorOptions
    min_score: float = option("Boxes of a lower score stay as they are.", default=0.5)
    box_model: BoxModel = option(BOX_MODEL_HELP, default=BoxModel.CUBOID)
    weights: WeightsOption = None
    box_origin: BoxOrigin = option(
        "What KITTI's lines give of a box: the centre of its bottom face, or its centre.", default=BoxOrigin.BOTTOM
    )


def refine_command(
    boxes: Annotated[
        Path,
        typer.Argument(
            metavar="BOXES",
            help="KITTI's object lines of an image, a folder of such files, tracking lines; or detections of nuScenes, "
            "TruckScenes, ZOD (JSON) or Argoverse 2 (feather).",
        ),
    ],
    images: Annotated[
        Path, typer.Argument(metavar="IMAGES|DATASET", help="The image, the folder of images, or the data set.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE|FOLDER", help="For the boxes, in the same format.")],
    options: RefineOptions,
    terminal: Terminal,
    json_out: JsonOption = None,
) -> None:
    """Refine the 3D boxes of cars and vans that any detector found.

    Keypoints are found in each 2D box (where a line has none, in the projection of its 3D box). All vehicles of an
    image are then solved together on one ground, each with its 3D box as evidence. Lines of other objects stay as they
    are, and so do boxes of which the keypoints say too little or that they contradict: each with its reason.

    The camera is that of --calib (a KITTI file, or a folder with one for each image), --camera or --intrinsics; in the
    folders of KITTI's layout it is found. A data set has its own, DATASET#SEQUENCE/CAMERA; nuScenes' images alone need
    --camera with the folder of its tables. Locations are in the frame of KITTI's labels where the calibration says
    where that is. --verbose lists every box of several images.

    Exit code 0: at least one box was refined; 1: none; 2: bad usage, or no image that can be used.
    """
    from fgrecon.cli import refine_report as report
    from fgrecon.core.options import BoxOptions, Options
    from fgrecon.perception.refine_files import Refiner, RefineRequest, open_boxes

    check_outputs(json_out)
    screen = terminal.screen(json_out)
    scene, camera = options.scene, options.camera
    box = BoxOptions(model=options.box_model)
    request = RefineRequest(
        errors=options.errors.errors(),
        settings=scene.settings(Options(strategy=scene.strategy, box=box, keep_history=False)),
        camera=camera.source(),
        min_score=options.min_score,
        weights=options.weights,
        box_origin=options.box_origin,
        sensors=options.sensors.source(camera.source()),
    )
    files = open_boxes(boxes, images, out, camera.camera)
    if request.sensors is not None:
        request.sensors.check(image.image.name for image in files.images if image.image is not None)
    read = [*(image.image for image in files.images if image.image is not None), *files_in(camera.calib)]
    for target in files.targets:
        check_not_over("out", target, read)
    refiner = Refiner(request, files.images)
    done = []
    for image in screen.watch(files.images, "Images"):
        done.append(refiner(image))
        files.add(done[-1])
    files.finish()
    report.show(screen, done)
    screen.wrote(out)
    screen.write_json(report.document(request, done))
    if not any(box.changed for image in done for _, box in image.boxes):
        screen.fail("No box could be refined.")
        raise typer.Exit(1)
