"""The work of `fgrecon refine`: each image's lines, refined and written back; the table and the JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from fgrecon.cli.options import CameraOptions
from fgrecon.cli.settings import Settings, plain_camera, plain_settings
from fgrecon.cli.terminal import Screen
from fgrecon.core.box3d import BoxErrors
from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.refined_box import RefinedBox
from fgrecon.core.text import counted, printable
from fgrecon.io.box_lines import Boxed, BoxedImage, text_of
from fgrecon.io.files import write_text
from fgrecon.io.images import read_image
from fgrecon.io.kitti_calibration import calibration_beside, read_calibration
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.refine import refine_boxes

__all__ = ["FORMAT", "KINDS", "Done", "RefineWork", "Refiner", "check_any", "document", "show", "write_each"]

FORMAT = "fgrecon.refined-boxes/1"
KINDS = "Car", "Van", "car"
"""Types of objects that are refined: KITTI's, nuScenes'."""

_SHOWN = 40  # boxes in the table of several images, without --verbose


@dataclass(frozen=True)
class RefineWork:
    """What holds for all images.

    Attributes:
        errors: How far the boxes are off.
        settings: Prior, ground, size prior and options.
        min_score: Boxes of a lower score stay as they are.
        camera: The command line's camera.
        weights: Keypoint network, or None for the shipped one.
    """

    errors: BoxErrors
    settings: Settings
    min_score: float
    camera: CameraOptions
    weights: Path | None


@dataclass(frozen=True)
class Done:
    """An image whose boxes were refined.

    Attributes:
        image: It, and its objects.
        camera: The camera; None where the image could not be used.
        offset: (3,) where the labels' frame lies from the camera's.
        boxes: The vehicles with what became of their boxes.
        error: Why nothing could be done, or None.
    """

    image: BoxedImage[Boxed]
    camera: Camera | None
    offset: NDArray[np.float64]
    boxes: tuple[tuple[Boxed, RefinedBox], ...]
    error: FgreconError | None = None

    @property
    def changed(self) -> dict[int, Any]:
        """How the file has the vehicles whose boxes were refined, by their numbers."""
        return {one.number: one.with_box(box.box, self.offset) for one, box in self.boxes if box.changed}


class Refiner:
    """Refines image after image; the network is loaded once."""

    def __init__(self, how: RefineWork) -> None:
        self.how = how

    def __call__(self, one: BoxedImage[Boxed]) -> Done:
        """Refine an image's boxes; one that cannot be used keeps them, and says why."""
        nowhere = np.zeros(3)
        if one.image is None:
            return Done(one, None, nowhere, (), InvalidInputError("images", f"none of {one.name}", "Give its image."))
        try:
            camera, offset = self._camera(one.image)
            boxed = [
                (line, box)
                for line in one.objects
                if line.kind in KINDS and line.score >= self.how.min_score and (box := line.box(offset)) is not None
            ]
            pixels = read_image(one.image)
            sized = camera.with_size_of(pixels)
            settings = self.how.settings
            found = refine_boxes(
                pixels,
                [box for _, box in boxed],
                sized,
                corners=np.array([line.corners for line, _ in boxed]).reshape(-1, 4),
                box_errors=self.how.errors,
                keypoint_detector=self._network,
                prior=settings.prior,
                ground=settings.ground,
                size_prior=settings.size_prior,
                options=settings.options,
            )
        except FgreconError as error:
            return Done(one, None, nowhere, (), error)
        lines = [line for line, _ in boxed]
        return Done(one, sized, offset, tuple(zip(lines, found, strict=True)))

    @cached_property
    def _network(self) -> KeypointCascade:
        return KeypointCascade(self.how.weights)

    def _camera(self, image: Path) -> tuple[Camera, NDArray[np.float64]]:
        """The camera of an image, and where the labels' frame lies from its own."""
        given = self.how.camera
        if given.calib is not None and given.calib.is_dir():
            own = read_calibration(given.calib / f"{image.stem}.txt")
            return own.camera, own.label_offset
        source = given.source()
        camera, offset = source.camera(image.name)
        if camera is None:
            beside = calibration_beside(image)
            if beside is None:
                fix = "Give --calib, --camera or --intrinsics."
                raise InvalidInputError("camera", f"none for {image}", fix)
            camera, offset = beside.camera, beside.label_offset
        return source.complete(camera, declared=False), np.zeros(3) if offset is None else offset


def check_any(done: Sequence[Done]) -> None:
    """See that at least one image could be used.

    Raises:
        FgreconError: None could; it is the first one's error.
    """
    errors = [one.error for one in done if one.error is not None]
    if errors and len(errors) == len(done):
        raise errors[0]


def write_each(out: Path, done: Sequence[Done]) -> None:
    """Write the boxes of images, of each to a file of its own.

    Raises:
        InvalidInputError: A file cannot be written.
    """
    for one in done:
        lines: list[Any] = [*one.image.objects]
        write_text(out / one.image.source.name, text_of(lines, one.changed))


def show(screen: Screen, done: Sequence[Done]) -> None:
    """A row for each box, the first ones of several images; what could not be used; and how many were refined."""
    rows = [(one, line, box) for one in done for line, box in one.boxes]
    shown = rows if screen.verbose or len(done) == 1 else rows[:_SHOWN]
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    for heading in ("image", "line", "type", "at m", "moved m", "± m", "turned °", "± °", "l, w, h by cm", "facing %"):
        table.add_column(heading, justify="left" if heading in ("image", "type") else "right", no_wrap=True)
    table.add_column("")
    for one, line, box in shown:
        table.add_row(
            *(escape(printable(cell)) for cell in (one.image.name, str(line.number), line.kind, *_cells(box)))
        )
    if shown:
        screen.print(table)
    if len(shown) < len(rows):
        screen.print(f"{len(rows) - len(shown)} more: --verbose lists them, --json writes them.")
    for one in done:
        if one.error is not None:
            screen.warn(f"{one.image.name}: the boxes stay as they are: {one.error}")
    changed = [box for _, _, box in rows if box.changed]
    round_ = sum(box.turned_round for box in changed)
    screen.print(
        f"{len(changed)} of {counted(len(rows), 'box', 'boxes')} in {counted(len(done), 'image')} were refined, "
        f"{round_} of them turned round; {len(rows) - len(changed)} stay as they are."
    )


def _cells(box: RefinedBox) -> tuple[str, ...]:
    at = f"{np.linalg.norm(box.given.location):.1f}"
    covariance, yaw = box.location_covariance, box.yaw_sigma
    if not box.changed or covariance is None or yaw is None:
        return at, "", "", "", "", "", "", box.message
    size = ""
    if box.box.size is not None and box.given.size is not None:
        size = ", ".join(f"{100.0 * change:+.0f}" for change in box.box.size - box.given.size)
    return (
        at,
        f"{np.linalg.norm(box.moved):.2f}",
        f"{np.sqrt(np.linalg.eigvalsh(covariance)[-1]):.2f}",
        f"{np.degrees(box.turn):.1f}",
        f"{np.degrees(yaw):.1f}",
        size,
        "" if np.isnan(box.facing_probability) else f"{100.0 * box.facing_probability:.0f}",
        "" if box.result is None or box.result.status.value == "converged" else box.result.status.value,
    )


def document(how: RefineWork, done: Sequence[Done]) -> str:
    """The JSON text: settings, and every box before and after. Locations are in the camera's frame."""
    content = {
        "format": FORMAT,
        "fgrecon": metadata.version("fgrecon"),
        "settings": plain_settings(how.settings) | {"box_errors": asdict(how.errors), "min_score": how.min_score},
        "images": [
            {
                "image": one.image.name,
                "file": None if one.image.image is None else str(one.image.image),
                "boxes_file": str(one.image.source),
                "camera": None if one.camera is None else plain_camera(one.camera),
                "label_offset": one.offset.tolist(),
                "error": None if one.error is None else str(one.error),
                "boxes": [{**line.place, "type": line.kind, **box.to_dict()} for line, box in one.boxes],
            }
            for one in done
        ],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
