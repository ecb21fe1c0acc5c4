"""`fgrecon export`: results as files for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.commands import option
from fgrecon.cli.options import PRIORS, fitting_names
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Verbosity
from fgrecon.core.text import counted

_FORMATS = (
    "nuscenes, nuscenes_tracking, truckscenes, zod, coco, cityscapes3d, openlabel, label_studio, scalabel, labelme, "
    "supervisely, datumaro or fiftyone for .json; cvat for .xml; foxglove, vision_msgs or ros2 for .mcap; kitti, tum "
    "or kitti_poses for .txt."
)


def _kinds() -> list[str]:
    from fgrecon.io.export import KINDS

    return list(KINDS)


@dataclass(frozen=True)
class ExportOptions:
    """What kind of file is written, and what it needs beside the results."""

    kind: str | None = option(
        _FORMATS, "--format", metavar="NAME", show_default="by the ending", autocompletion=fitting_names(_kinds)
    )
    images: Path | None = option(
        "Tokens, ids, times and camera poses of the images (see File formats), or their data set; or their "
        "bag, of which ros2 makes a copy.",
        metavar="FILE.json|DATASET|BAG",
    )
    prior: str | None = option(
        "Shape prior that the results' surfaces are made from.",
        metavar="NAME|FILE",
        show_default="as the results say",
        autocompletion=PRIORS,
    )


def export_command(
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS",
            help="Results as written by --json of reconstruct or track, or demo; "
            "or the folder of a batch, a run or of reconstruct's --out.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="File to write: .ply, .glb, .csv, .parquet, .txt, .json, .xml, .feather, .bin, .mcap."
        ),
    ],
    options: ExportOptions,
    terminal: Verbosity,
    json_out: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write what OUT has no place for as JSON; - for the output."),
    ] = None,
) -> None:
    """Write results for other programs; the ending of OUT, or --format, chooses the kind of file.

    PLY and GLB: surfaces and wireframes in the camera frame. CSV and Parquet: one row per vehicle. TXT: KITTI's result
    lines of one image, in the frame of KITTI's labels where the results know it; or the camera's path (TUM, KITTI).
    JSON: boxes for nuScenes, TruckScenes, ZOD or Cityscapes, COCO's keypoints with cuboids, OpenLABEL, Label Studio,
    scalabel, labelme, Supervisely, datumaro or FiftyOne. XML: CVAT. FEATHER: Argoverse 2's detections. BIN: Waymo's.
    MCAP: Foxglove's scenes, or ROS 2's Detection3DArray, under an upright frame `map`; or with rviz's markers and
    Foxglove's scenes in a copy of the bag that a run was on (ros2).
    What the kind of file has no place for is a warning. --verbose names the vehicles.

    Of a video's run JSON, FEATHER, BIN, MCAP and the camera's path are made; its folder has tables already.
    """
    from fgrecon.io.bag import is_bag
    from fgrecon.io.export import export, read_images_file, read_results, read_video_frames
    from fgrecon.io.export.bag_copy import export_into_bag
    from fgrecon.io.export.formats import check_format
    from fgrecon.io.export.losses import loss_warning, not_written
    from fgrecon.io.export.video_frames import check_video_format, frames_file
    from fgrecon.io.files import check_output

    kind = check_format(out, options.kind)
    check_output(out)
    check_outputs(json_out)
    images_known = None if options.images is None else read_images_file(options.images)
    if (frames := frames_file(results)) is not None:
        check_video_format(out, options.kind)
        found, images_known = read_video_frames(frames, images_known)
    elif (results / "_run.json").exists() or (results.is_dir() and not any(results.glob("*.json"))):
        from fgrecon.batch import read_folder

        found = read_folder(results, options.prior)
    else:
        found = read_results(results, options.prior)
    if options.kind == "ros2" and options.images is not None and is_bag(options.images):
        export_into_bag(out, found, images_known or {}, options.images)
    else:
        export(out, found, options.kind, images_known)
    screen, lost = terminal.screen(json_out), not_written(kind, found)
    for vehicle in found:
        screen.detail(f"{vehicle.name}: {vehicle.result.status.value}")
    screen.print(f"{counted(len(found), 'vehicle')}.")
    if lost:
        screen.warn(loss_warning(kind, lost))
    screen.wrote(out)
    about = {"format": "fgrecon.export/1", "file": str(out), "kind": kind, "vehicles": len(found)}
    screen.write_document({**about, "not_written": lost})
