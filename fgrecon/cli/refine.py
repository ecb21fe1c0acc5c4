"""`fgrecon refine`: better 3D boxes of another detector, by the keypoints of the vehicles in them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.box_errors import BoxErrorOptions
from fgrecon.cli.common import check_outputs
from fgrecon.cli.options import BOX_MODEL_HELP, CameraOptions, JsonOption, SceneOptions, WeightsOption
from fgrecon.cli.overwrites import check_not_over, files_in
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import behind_links

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.io.box_lines import BoxedImage
    from fgrecon.io.nuscenes_detections import Submission

__all__ = ["refine_command"]


def refine_command(
    boxes: Annotated[
        Path,
        typer.Argument(
            metavar="BOXES",
            help="KITTI's object lines of an image, a folder of such files, tracking lines, or nuScenes' submission.",
        ),
    ],
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="The image, or the folder of images.")],
    out: Annotated[Path, typer.Option(metavar="FILE|FOLDER", help="For the boxes, in the same format.")],
    camera: CameraOptions,
    scene: SceneOptions,
    errors: BoxErrorOptions,
    terminal: Terminal,
    min_score: Annotated[float, typer.Option(help="Boxes of a lower score stay as they are.")] = 0.5,
    box_model: Annotated[BoxModel, typer.Option(help=BOX_MODEL_HELP)] = BoxModel.CUBOID,
    weights: WeightsOption = None,
    json_out: JsonOption = None,
) -> None:
    """Refine the 3D boxes of cars and vans that any detector found.

    Keypoints are found in each 2D box (where a line has none, in the projection of its 3D box). All vehicles of an
    image are then solved together on one ground, each with its 3D box as evidence. Lines of other objects stay as they
    are, and so do boxes of which the keypoints say too little or that they contradict: each with its reason.

    The camera is that of --calib (a KITTI file, or a folder with one for each image), --camera or --intrinsics; in the
    folders of KITTI's layout it is found. nuScenes' boxes need --camera with the folder of its tables. Locations are in
    the frame of KITTI's labels where the calibration says where that is. --verbose lists every box of several images.

    Exit code 0: at least one box was refined; 1: none; 2: bad usage, or no image that can be used.
    """
    from fgrecon.cli import refine_work
    from fgrecon.core.options import BoxOptions, Options
    from fgrecon.io.box_lines import boxed_images, text_of
    from fgrecon.io.files import write_text
    from fgrecon.io.nuscenes_detections import is_submission

    check_outputs(json_out)
    if not math.isfinite(min_score):
        raise InvalidInputError("min_score", min_score, "Give a finite number, less than all scores to refine all.")
    screen = terminal.screen(json_out)
    submission = _submission(boxes, images, camera.camera) if is_submission(boxes) else None
    lines = boxed_images(boxes, images) if submission is None else []
    found: list[BoxedImage[Any]] = [*lines] if submission is None else [*submission.images]
    _check_out(out, boxes, found, camera.calib)
    how = refine_work.RefineWork(
        errors=errors.errors(),
        settings=scene.settings(Options(strategy=scene.strategy, box=BoxOptions(model=box_model), keep_history=False)),
        min_score=min_score,
        camera=camera,
        weights=weights,
    )
    work = refine_work.Refiner(how)
    done: list[refine_work.Done] = []
    waiting: list[refine_work.Done] = []  # nothing is written as long as no image can be used
    for one in screen.watch(found, "Images"):
        done.append(work(one))
        waiting.append(done[-1])
        if boxes.is_dir() and any(image.error is None for image in waiting):
            refine_work.write_each(out, waiting)
            waiting.clear()
    refine_work.check_any(done)
    if boxes.is_dir():
        refine_work.write_each(out, waiting)
    changed = {number: text for one in done for number, text in one.changed.items()}
    if submission is not None:
        write_text(out, submission.text(changed))
    elif not boxes.is_dir():
        write_text(out, text_of([line for one in lines for line in one.objects], changed))
    refine_work.show(screen, done)
    screen.wrote(out)
    screen.write_json(refine_work.document(how, done))
    if not any(box.changed for image in done for _, box in image.boxes):
        screen.fail("No box could be refined.")
        raise typer.Exit(1)


def _submission(boxes: Path, images: Path, tables: str | None) -> Submission:
    """NuScenes' boxes and the images that show them.

    Raises:
        InvalidInputError: There are no tables, or a file is malformed.
    """
    from fgrecon.io.nuscenes import is_nuscenes, open_nuscenes
    from fgrecon.io.nuscenes_detections import read_submission

    if tables is None or not is_nuscenes(Path(tables)):
        raise InvalidInputError(
            "camera", tables or "nothing", "Give the folder of nuScenes' tables, such as v1.0-mini."
        )
    return read_submission(boxes, images, open_nuscenes(Path(tables)))


def _check_out(out: Path, boxes: Path, found: list[BoxedImage[Any]], calib: Path | None) -> None:
    """Refuse before the work what could not be written after it, or would write over the input."""
    if behind_links(out) == behind_links(boxes):
        raise InvalidInputError("out", str(out), "Give another place than that of the boxes.")
    if boxes.is_dir():
        if out.exists() and not out.is_dir():
            raise InvalidInputError("out", str(out), "Give a folder: the boxes are in one.")
        read = [*(one.image for one in found if one.image is not None), *files_in(calib)]
        for one in found:
            check_not_over("out", out / one.source.name, read)
        out.mkdir(parents=True, exist_ok=True)
    else:
        check_outputs(None, out)
    if not any(one.image is not None for one in found):
        raise InvalidInputError(
            "images", f"none of {found[0].name} and {len(found) - 1} more", "Name images as the boxes."
        )
