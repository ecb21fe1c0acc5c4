"""`fgrecon keypoints label`: keypoints of vehicles whose boxes are labelled, as COCO's JSON."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.calibration.selection import Selection
from fgrecon.cli.options import FLEETS, GroundOption, JsonOption, PriorOption, WeightsOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal, stepwise
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.parsing import parse_ground
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.coco_keypoints import write_coco_keypoints
from fgrecon.io.datasets import open_drive
from fgrecon.io.files import check_ending
from fgrecon.io.kitti_drives import read_drive
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon_research.annotation.unboxed import Unboxed
from fgrecon_research.cli.training import label_report as report


@dataclass(frozen=True)
class SelectionOptions:
    """Which vehicles are labelled; see `fgrecon.calibration.selection.Selection`."""

    kinds: Annotated[str, typer.Option(metavar="KIND,KIND,...", help="Kinds of objects.")] = "Car,Van"
    least_height: Annotated[float, typer.Option(help="Least height of the 2D box, pixels.")] = 25.0
    occlusion: Annotated[int, typer.Option(help="Most of KITTI's grade: 0 visible, 1 partly, 2 largely occluded.")] = 2
    truncation: Annotated[float, typer.Option(help="Largest share outside the image.")] = 0.5

    def selection(self) -> Selection:
        """The same for the work.

        Raises:
            InvalidInputError: There is no kind, or a limit lets nothing through.
        """
        kinds = tuple(kind.strip() for kind in self.kinds.split(",") if kind.strip())
        return Selection(kinds, self.least_height, self.occlusion, self.truncation)


@dataclass(frozen=True)
class UnboxedOptions:
    """What is known of vehicles without 3D boxes; see `fgrecon_research.annotation.unboxed.Unboxed`."""

    camera_height: Annotated[
        float | None,
        typer.Option(help="Height of a level camera above the ground, m: also label vehicles without 3D boxes."),
    ] = None
    ground: GroundOption = None
    size_prior: Annotated[
        str | None,
        typer.Option(
            metavar="FLEET",
            help="Sizes of vehicles without 3D boxes: kitti, apollo79 or length,width,height in m.",
            show_default="as in the shape prior",
            autocompletion=FLEETS,
        ),
    ] = None

    def known(self) -> Unboxed | None:
        """The same for the work; None where nothing is known.

        Raises:
            InvalidInputError: Both a plane and a height are given, or a value names nothing.
        """
        plane = parse_ground(self.ground, self.camera_height)
        if plane is None and self.size_prior is None:
            return None
        return Unboxed(plane and plane[0], None if self.size_prior is None else size_prior(self.size_prior))


def _check_tracked(folders: list[Path], known: Unboxed | None) -> None:
    """Refuse a tracker's results that fit no drive, or of whose vehicles nothing is known."""
    if len(folders) > 1:
        raise InvalidInputError("--tracks", f"{len(folders)} drives", "Give one drive: the file is of one.")
    if known is None:
        fix = "Give --camera-height, --ground or --size-prior as well: its vehicles have no labelled boxes."
        raise InvalidInputError("--tracks", "nothing known of its vehicles", fix)


def label_command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DRIVE",
            help="Folder with image_02, label_02.txt, calib.txt (KITTI tracking) or image_2, label_2, calib (object); "
            "or FOLDER#SEQUENCE/CAMERA of a data set.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The labels: COCO keypoints (JSON).")],
    which: SelectionOptions,
    unboxed: UnboxedOptions,
    terminal: Terminal,
    tracks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Instead of label_02.txt: 2D boxes and ids of a tracker (KITTI tracking, such as tracks.txt of "
            "`fgrecon run`).",
        ),
    ] = None,
    lidar: Annotated[
        bool,
        typer.Option("--lidar", help="Take the LiDAR's points of each frame that has some (lidar or velodyne beside)."),
    ] = False,
    weights: WeightsOption = None,
    prior: PriorOption = "car14",
    meshes: Annotated[bool, typer.Option("--meshes", help="Also write each vehicle's surface.")] = False,
    terms: Annotated[
        str,
        typer.Option("--license", metavar="TEXT", help="Terms of the images, such as CC BY-NC-SA 3.0, for the file."),
    ] = "",
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw some of the labelled vehicles (png, jpg, svg, pdf).")
    ] = None,
    json_out: JsonOption = None,
) -> None:
    """Label the keypoints of vehicles whose 3D boxes are known, hidden ones as well, all images of each together.

    A factor graph outvotes the network where box and other images contradict it. Vehicles without 3D boxes are left out
    unless the ground or their size is given; then their tracks are reconstructed, and what is sure is kept. With
    --tracks no labels are needed. Images are named relative to the file.
    --verbose names every vehicle that is left out.

    Exit code 0: labels were written; 1: no vehicle could be labelled; 2: bad usage or input.
    """
    check_outputs(json_out, out, picture=picture)
    check_ending(out, ["json"])
    screen = terminal.screen(json_out)
    selection, known, shape_prior = which.selection(), unboxed.known(), load_prior(prior)
    if tracks is None:
        drives = [open_drive(folder) for folder in folders]
    else:
        _check_tracked(folders, known)
        drives = [read_drive(folder.absolute(), tracks) for folder in folders]
    detector = KeypointCascade(weights)
    with screen.bar() as advance:
        watch = partial(stepwise, advance=advance)
        done = report.label_drives(drives, detector, shape_prior, watch, selection, known, lidar=lidar)
    labels = report.labels_of(done, shape_prior, detector.provenance, terms)
    report.show(screen, done, labels)
    screen.write_json(report.document(done, labels))
    if not labels.vehicles:
        screen.fail("no vehicle could be labelled.")
        raise typer.Exit(1)
    screen.wrote(write_coco_keypoints(out, labels, meshes=meshes))
    if picture is not None:
        screen.wrote(report.draw(picture, labels))
