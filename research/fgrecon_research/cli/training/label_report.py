"""What `fgrecon keypoints label` says and draws. Imported when it runs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from fgrecon.calibration.selection import LeftOut, Reason, Selection
from fgrecon.cli.terminal import Screen
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.coco_keypoints import VehicleLabel, VehicleLabels, write_coco_keypoints
from fgrecon.io.datasets import open_drive
from fgrecon.io.images import read_image
from fgrecon.io.kitti_drives import Drive
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.viz.picture import save_picture
from fgrecon_research.annotation.annotate import annotate
from fgrecon_research.annotation.annotation import Annotation
from fgrecon_research.annotation.labels import vehicle_labels
from fgrecon_research.annotation.unboxed import Unboxed
from fgrecon_research.io.drive_sensors import Sensor, scan_of, with_sensors
from fgrecon_research.training.keypoints.posed_cars import Progress
from fgrecon_research.viz.label_sheet import label_sheet

_LEARNT = "Car", "Van", "Truck"  # of the last the direction and the kind
_DRAWN = 24  # vehicles of a picture, at most
_TERMS = (
    "The images are under the terms of their owners. The keypoints come from a network that has learnt from images of "
    "others, whose terms its model card has; for those of fgrecon see fgrecon/data/LICENSE-DATA.md."
)


@dataclass
class Clock:
    """How long something took, seconds."""

    seconds: float = 0.0


@contextmanager
def timed() -> Iterator[Clock]:
    """Takes the time."""
    clock, started = Clock(), perf_counter()
    yield clock
    clock.seconds = perf_counter() - started


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

        with timed() as clock:
            points = scan_of if lidar else None
            made, left = annotate(drive, detector, prior, selection, None, watched, unboxed, points)
        done.append(Labelled(drive, made, left, clock.seconds))
    return done


def label_street(drives: Sequence[Path], network: Path, out: Path, watch: Progress) -> None:
    """Label the street cars that a training learns from.

    Args:
        out: The file to write (COCO).

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
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("drive", "vehicles", "images", "labels", "visible", "hidden", "outside", "left out", "s a label"):
        table.add_column(heading, justify="right" if heading != "drive" else "left")
    rows = [_counts(one, labels) for one in done]
    for row in (*rows, *([_total(rows)] if len(rows) > 1 else [])):
        each = row["seconds"] / row["labels"] if row["labels"] else np.nan
        table.add_row(*(str(value) for name, value in row.items() if name != "seconds"), f"{each:.2f}")
    screen.print(table)
    reasons = _reasons([left for one in done for left in one.left])
    if reasons:
        why = Table(box=SIMPLE_HEAD, pad_edge=False)
        why.add_column("left out because")
        why.add_column("objects", justify="right")
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


def _total(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {"drive": "all"} | {name: sum(row[name] for row in rows) for name in rows[0] if name != "drive"}


def _reasons(left: Sequence[LeftOut]) -> dict[str, int]:
    """How many objects were left out, by reason."""
    counts = Counter(one.reason for one in left)
    return {str(reason): counts[reason] for reason in Reason if counts[reason]}
