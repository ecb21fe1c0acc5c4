"""`fgrecon reconstruct`: pose and shape of every vehicle in a keypoint file, or in boxes of an image."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import (
    BOX_MODEL_HELP,
    BoxesOption,
    BoxOption,
    CalibOption,
    CameraHeightOption,
    DetectOption,
    GroundOption,
    IntrinsicsOption,
    JsonOption,
    PriorOption,
    SizePriorOption,
    StrategyOption,
    check_outputs,
    console,
    write_json,
)
from fgrecon.cli.deliver import ConnectOption, SaveOption, SpawnOption, check_delivery, deliver, wants_recording
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.core.robust import StrategyName

__all__ = ["reconstruct_command"]


def reconstruct_command(
    keypoints: Annotated[Path, typer.Argument(help="Keypoints (JSON, format in the README), a track, or an image.")],
    calib: CalibOption = None,
    intrinsics: IntrinsicsOption = None,
    distortion: Annotated[
        str | None, typer.Option(metavar="K1,K2,P1,P2,...", help="OpenCV's distortion coefficients.")
    ] = None,
    prior: PriorOption = "car14",
    camera_height: CameraHeightOption = None,
    ground: GroundOption = None,
    size_prior: SizePriorOption = None,
    strategy: StrategyOption = StrategyName.MIXTURE,
    box_model: Annotated[
        BoxModel | None,
        typer.Option(
            help=BOX_MODEL_HELP,
            show_default="surface; cuboid for KITTI's boxes",
        ),
    ] = None,
    joint: Annotated[
        bool, typer.Option("--joint/--no-joint", help="Let pose and shape move together at the end.")
    ] = True,
    free_offsets: Annotated[
        bool, typer.Option("--free-offsets", help="Let every keypoint leave the shape prior by a small offset.")
    ] = False,
    box: BoxOption = None,
    boxes: BoxesOption = None,
    detect: DetectOption = False,
    weights: Annotated[Path | None, typer.Option(help="Keypoint network.", show_default="the shipped one")] = None,
    image: Annotated[Path | None, typer.Option(help="The photograph: to draw on, and for its size.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the result (png, svg, pdf, jpg); several: a sheet.")
    ] = None,
    animation: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Animate the optimisation of a single vehicle (gif, mp4).")
    ] = None,
    save: SaveOption = None,
    connect: ConnectOption = None,
    spawn: SpawnOption = False,
    json_out: JsonOption = None,
) -> None:
    """Reconstruct the pose and shape of the vehicles in a keypoint file, or in an image (--box, --boxes or --detect).

    A vehicle that is refused is reported, and the others go on.

    Exit code 0: at least one was reconstructed; 1: none, since solving failed; 2: none, since the input is bad, or no
    car was found in the image.
    """
    from fgrecon.cli import batch, picture_tasks, show
    from fgrecon.core.options import Options, ShapeOptions
    from fgrecon.io.images import read_image

    _check_outputs(picture, animation, json_out)
    check_delivery(save, connect)
    options = Options(
        strategy=strategy,
        box=box_model or BoxModel.SURFACE,
        shape=ShapeOptions(joint=joint, free_offsets=free_offsets),
    )
    settings = batch.Settings.of(prior, ground, camera_height, size_prior, options)
    pictured = picture_tasks.is_image(keypoints)
    if pictured:
        image = keypoints
    else:
        picture_tasks.refuse_image_options(box, boxes, weights, detect=detect)
    photograph = None if image is None else read_image(image)
    source = batch.CameraSource(calib, intrinsics, distortion, photograph)
    ignored: tuple[str, ...] = ()
    warning: str | None = None
    if pictured and photograph is not None:
        tasks, warning = picture_tasks.read_image_tasks(
            keypoints,
            photograph,
            source,
            settings.prior.category,
            box=box,
            boxes=boxes,
            detect=detect,
            weights=weights,
            box_model=box_model,
        )
    else:
        tasks, ignored = batch.read_tasks(keypoints, settings.prior.category, source)
    outcomes = [batch.run(task, settings) for task in tasks]

    out = console(error=json_out == "-")
    if warning is not None:
        console(error=True).print(f"Warning: {warning}", markup=False)
    show.print_table(out, outcomes)
    if ignored:
        out.print(f"Fields of the file without a meaning here: {', '.join(ignored)}.", markup=False)
    if json_out is not None:
        write_json(json_out, show.document(keypoints, outcomes, settings))
    if picture is not None:
        show.draw(picture, outcomes, photograph)
    if animation is not None:
        show.draw_moving(animation, outcomes, photograph)
    if wants_recording(save, connect, spawn=spawn):
        recordings = show.recordings(outcomes, photograph, settings.ground)
        deliver(recordings, save, connect, spawn=spawn, several=len(outcomes) > 1)
    if not batch.check_any(keypoints, outcomes):
        raise typer.Exit(1)


def _check_outputs(picture: Path | None, animation: Path | None, json_out: str | None) -> None:
    from fgrecon.viz.animation import check_format
    from fgrecon.viz.picture import FORMATS

    check_outputs(json_out, picture, animation)
    if picture is not None and picture.suffix.lower().removeprefix(".") not in FORMATS:
        raise InvalidInputError("picture", str(picture), f"Let the name end in one of {', '.join(FORMATS)}.")
    if animation is not None:
        check_format(animation)
