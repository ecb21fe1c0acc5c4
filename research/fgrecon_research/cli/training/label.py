"""`fgrecon keypoints label`: keypoints of vehicles whose boxes are labelled, as COCO's JSON, and what it shows."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer

from fgrecon.calibration.labelled_boxes import LeftOut, Reason, Selection
from fgrecon.cli.commands import option
from fgrecon.cli.options import FLEETS, GroundOption, JsonOption, PriorOption, WeightsOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Screen, Terminal, headed_table, stepwise
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.parsing import parse_ground
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.coco_keypoints import VehicleLabel, VehicleLabels, write_coco_keypoints
from fgrecon.io.datasets import open_drive
from fgrecon.io.files import check_ending
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Drive, read_drive
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.viz.picture import save_picture
from fgrecon_research.annotation.annotate import annotate
from fgrecon_research.annotation.annotation import Annotation
from fgrecon_research.annotation.labels import vehicle_labels
from fgrecon_research.annotation.unboxed import Unboxed
from fgrecon_research.io.drive_sensors import Sensor, scan_of, with_sensors
from fgrecon_research.training.keypoints.posed_cars import Progress
from fgrecon_research.viz.label_sheet import label_sheet


@dataclass(frozen=True)
class SelectionOptions:
    """Which vehicles are labelled; see `fgrecon.calibration.labelled_boxes.Selection`."""

    kinds: str = option("Kinds of objects.", default="Car,Van", metavar="KIND,KIND,...")
    least_height: float = option("Least height of the 2D box, pixels.", default=25.0)
    occlusion: int = option("Most of KITTI's grade: 0 visible, 1 partly, 2 largely occluded.", default=2)
    truncation: float = option("Largest share outside the image.", default=0.5)

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

    camera_height: float | None = option(
        "Height of a level camera above the ground, m: also label vehicles without 3D boxes."
    )
    ground: GroundOption = None
    size_prior: str | None = option(
        "Sizes of vehicles without 3D boxes: kitti, apollo79 or length,width,height in m.",
        metavar="FLEET",
        show_default="as in the shape prior",
        autocompletion=FLEETS,
    )

    def known(self) -> Unboxed | None:
        """The same for the work; None where nothing is known.

        Raises:
            InvalidInputError: Both a plane and a height are given, or a value names nothing.
        """
        plane = parse_ground(self.ground, self.camera_height)
        if plane is None and self.size_prior is None:
            return None
        return Unboxed(plane and plane[0], None if self.size_prior is None else size_prior(self.size_prior))


@dataclass(frozen=True)
class LabelSource:
    """What the labels are made of, beside the images."""

    tracks: Path | None = option(
        "Instead of label_02.txt: 2D boxes and ids of a tracker (KITTI tracking, such as tracks.txt of `fgrecon run`).",
        metavar="FILE",
    )
    lidar: bool = option(
        "Take the LiDAR's points of each frame that has some (lidar or velodyne beside).", "--lidar", default=False
    )
    weights: WeightsOption = None
    prior: PriorOption = "car14"

    def drives(self, folders: Sequence[Path], known: Unboxed | None) -> list[Drive]:
        """The drives in some folders.

        Raises:
            InvalidInputError: A tracker's results fit no drive, or nothing is known of their vehicles.
        """
        if self.tracks is None:
            return [open_drive(folder) for folder in folders]
        if len(folders) > 1:
            raise InvalidInputError("--tracks", f"{len(folders)} drives", "Give one drive: the file is of one.")
        if known is None:
            fix = "Give --camera-height, --ground or --size-prior as well: its vehicles have no labelled boxes."
            raise InvalidInputError("--tracks", "nothing known of its vehicles", fix)
        return [read_drive(folder.absolute(), self.tracks) for folder in folders]


@dataclass(frozen=True)
class LabelOutputs:
    """What is written."""

    out: Annotated[Path, typer.Option(metavar="FILE", help="The labels: COCO keypoints (JSON).")]
    meshes: bool = option("Also write each vehicle's surface.", "--meshes", default=False)
    terms: str = option(
        "Terms of the images, such as CC BY-NC-SA 3.0, for the file.", "--license", default="", metavar="TEXT"
    )
    picture: Path | None = option("Draw some of the labelled vehicles (png, jpg, svg, pdf).", metavar="FILE")
    json_out: JsonOption = None


def label_command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DRIVE",
            help="Folder with image_02, label_02.txt, calib.txt (KITTI tracking) or image_2, label_2, calib (object); "
            "or FOLDER#SEQUENCE/CAMERA of a data set.",
        ),
    ],
    outputs: LabelOutputs,
    which: SelectionOptions,
    unboxed: UnboxedOptions,
    source: LabelSource,
    terminal: Terminal,
) -> None:
    """Label the keypoints of vehicles whose 3D boxes are known, hidden ones as well, all images of each together.

    A factor graph outvotes the network where box and other images contradict it. Vehicles without 3D boxes are left out
    unless the ground or their size is given; then their tracks are reconstructed, and what is sure is kept. With
    --tracks no labels are needed. Images are named relative to the file.
    --verbose names every vehicle that is left out.

    Exit code 0: labels were written; 1: no vehicle could be labelled; 2: bad usage or input.
    """
    check_outputs(outputs.json_out, outputs.out, picture=outputs.picture)
    check_ending(outputs.out, ["json"])
    screen = terminal.screen(outputs.json_out)
    selection, known, shape_prior = which.selection(), unboxed.known(), load_prior(source.prior)
    drives = source.drives(folders, known)
    detector = KeypointCascade(source.weights)
    with screen.bar() as advance:
        watch = partial(stepwise, advance=advance)
        done = label_drives(drives, detector, shape_prior, watch, selection, known, lidar=source.lidar)
    labels = labels_of(done, shape_prior, detector.provenance, outputs.terms)
    show(screen, done, labels)
    screen.write_json(document(done, labels))
    if not labels.vehicles:
        screen.fail("no vehicle could be labelled.")
        raise typer.Exit(1)
    screen.wrote(write_coco_keypoints(outputs.out, labels, meshes=outputs.meshes))
    if outputs.picture is not None:
        screen.wrote(draw(outputs.picture, labels))


_LEARNT = "Car", "Van", "Truck"  # of the last the direction and the kind
_DRAWN = 24  # vehicles of a picture, at most
_TERMS = (
    "The images are under the terms of their owners. The keypoints come from a network that has learnt from images of "
    "others, whose terms its model card has; for those of fgrecon see fgrecon/data/LICENSE-DATA.md."
)


@dataclass(frozen=True, eq=False)
class Labelled:
    """A drive, its annotations, what was left out, and how long it took in seconds."""

    drive: Drive
    made: Sequence[Annotation]
    left: Sequence[LeftOut]
    seconds: float


def label_drives(
    drives: Sequence[Drive],
    detector: KeypointCascade,
    prior: ShapePrior,
    watch: Progress,
    selection: Selection | None = None,
    unboxed: Unboxed | None = None,
    *,
    lidar: bool = False,
) -> list[Labelled]:
    """Label the vehicles of some drives; see `fgrecon_research.annotation.annotate`.

    Raises:
        InvalidInputError: As `annotate`; or LiDAR is requested, of which a drive has no file.
    """
    done = []
    for drive in drives:
        if lidar:
            with_sensors(drive, [Sensor.LIDAR])  # refuse before the work

        def watched(things: Sequence[Any], heading: str, name: str = drive.name) -> Iterable[Any]:
            return watch(things, f"{name}: {heading}")

        points, started = scan_of if lidar else None, perf_counter()
        made, left = annotate(drive, detector, prior, selection, watched, unboxed, points)
        done.append(Labelled(drive, made, left, perf_counter() - started))
    return done


def label_street(drives: Sequence[Path], network: Path, out: Path, watch: Progress) -> None:
    """Write a file (COCO) of labels of the street cars that a training learns from.

    Raises:
        InvalidInputError: A folder is no drive, or no vehicle could be labelled.
    """
    prior = load_prior("car14")
    detector = KeypointCascade(network)
    selection = replace(Selection(), kinds=_LEARNT)
    done = label_drives([open_drive(folder) for folder in drives], detector, prior, watch, selection)
    labels = labels_of(done, prior, detector.provenance)
    if not labels.vehicles:
        fix = "Give drives with labelled 3D boxes of cars."
        raise InvalidInputError("drives", ", ".join(map(str, drives)), fix)
    write_coco_keypoints(out, labels)


def labels_of(
    done: Sequence[Labelled], prior: ShapePrior, network: Mapping[str, str], terms: str = ""
) -> VehicleLabels:
    """All annotations as labels, with the terms of their images."""
    made = [(one.drive.name, annotation) for one in done for annotation in one.made]
    boxed = [annotation.boxed for _, annotation in made]
    if all(boxed):
        of = "with labelled 3D boxes"
    elif any(boxed):
        of = "with labelled 3D boxes and, reconstructed over time, without"
    else:
        of = "without labelled 3D boxes, reconstructed over time"
    info = {
        "description": f"Keypoints of vehicles {of}, by a factor graph over all images of each.",
        "fgrecon": metadata.version("fgrecon"),
        "terms": _TERMS,
        "prior": prior.name,
        **{f"network, {name}": value for name, value in network.items()},
    }
    return vehicle_labels(made, prior.category, info, terms)


def show(screen: Screen, done: Sequence[Labelled], labels: VehicleLabels) -> None:
    """Tables of what was labelled, and of what was not."""
    headings = "drive", "vehicles", "images", "labels", "visible", "hidden", "outside", "left out", "s a label"
    table = headed_table(*headings)
    rows = [_counts(one, labels) for one in done]
    if len(rows) > 1:
        rows.append({"drive": "all"} | {name: sum(row[name] for row in rows) for name in rows[0] if name != "drive"})
    for row in rows:
        each = row["seconds"] / row["labels"] if row["labels"] else np.nan
        table.add_row(*(str(value) for name, value in row.items() if name != "seconds"), f"{each:.2f}")
    screen.print(table)
    reasons = _reasons([left for one in done for left in one.left])
    if reasons:
        why = headed_table("left out because", "objects")
        for reason, count in reasons.items():
            why.add_row(reason, str(count))
        screen.print(why)
    for one in done:
        for left in one.left:
            screen.detail(f"{one.drive.name}, image {left.frame}: {left.kind} {left.track}: {left.reason}")


def document(done: Sequence[Labelled], labels: VehicleLabels) -> str:
    """The same as JSON."""
    drives = [_counts(one, labels) | {"reasons": _reasons(one.left)} for one in done]
    left = [
        {"drive": one.drive.name, "frame": o.frame, "track": o.track, "kind": o.kind, "reason": str(o.reason)}
        for one in done
        for o in one.left
    ]
    return json.dumps({"fgrecon": metadata.version("fgrecon"), "drives": drives, "left_out": left}, indent=1) + "\n"


def draw(path: Path, labels: VehicleLabels) -> Path:
    """A sheet of some of the labels, evenly from all.

    Raises:
        InvalidInputError: An image cannot be read, or the file cannot be written.
    """
    count = len(labels.vehicles)
    chosen: list[VehicleLabel] = [
        labels.vehicles[i] for i in np.linspace(0, count - 1, min(_DRAWN, count)).round().astype(int)
    ]
    return save_picture(path, label_sheet(labels, [(vehicle, read_image(vehicle.image.path)) for vehicle in chosen]))


def _counts(one: Labelled, labels: VehicleLabels) -> dict[str, Any]:
    paths = {frame.image for frame in one.drive.frames}
    own = [vehicle for vehicle in labels.vehicles if vehicle.image.path in paths]
    flags = np.concatenate([vehicle.flags for vehicle in own]) if own else np.zeros(0)
    return {
        "drive": one.drive.name,
        "vehicles": len({vehicle.track for vehicle in own}),
        "images": len({vehicle.image.path for vehicle in own}),
        "labels": len(own),
        "visible": int((flags == 2).sum()),
        "hidden": int((flags == 1).sum()),
        "outside": int((flags == 0).sum()),
        "left_out": len(one.left),
        "seconds": round(one.seconds, 3),
    }


def _reasons(left: Sequence[LeftOut]) -> dict[str, int]:
    """How many objects were left out, by reason."""
    counts = Counter(one.reason for one in left)
    return {str(reason): counts[reason] for reason in Reason if counts[reason]}
