"""What the workers of a service do: uploaded files solved, and made into what was requested.

They are run in processes of their own (`fgrecon.app.workers`), by the parts that commands are made of.
"""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.app.requested import Requested
from fgrecon.batch.results_file import document
from fgrecon.batch.solve_tasks import (
    Outcome,
    SolvedImage,
    check_any,
    fit_warnings,
    grounds_of,
    left_out_lines,
    solve_tasks,
)
from fgrecon.batch.vehicle_tasks import KeypointRequest, VehicleTask, image_tasks, input_warnings, read_tasks
from fgrecon.core.camera import Ground
from fgrecon.core.errors import ContradictoryInputWarning, FgreconError, InvalidInputError
from fgrecon.io.cameras.camera_source import CameraSource, assumed_focal_length
from fgrecon.io.images import IMAGES, read_photograph
from fgrecon.io.run_settings import RunSettings
from fgrecon.perception.boxes import boxes_of


@dataclass(frozen=True)
class Uploaded:
    """Names of uploaded files, in the folder that a worker is given.

    Attributes:
        main: A photograph or a keypoint file.
        camera: A calibration file, or None.
        boxes: A file of boxes, or None.
        photograph: What the keypoints are drawn on, or None.
    """

    main: str
    camera: str | None = None
    boxes: str | None = None
    photograph: str | None = None

    @property
    def of_image(self) -> bool:
        """Whether it is a photograph."""
        return Path(self.main).suffix.lower() in IMAGES


@dataclass(frozen=True)
class SolvedUpload:
    """What became of an upload.

    Attributes:
        outcomes: One per vehicle.
        images: What was solved together.
        settings: What held for all.
        warnings: What to say of it.
        pixels: (H, W, 3) the photograph, or None.
    """

    outcomes: list[Outcome]
    images: list[SolvedImage]
    settings: RunSettings
    warnings: list[str] = field(default_factory=list)
    pixels: NDArray[np.uint8] | None = None

    @property
    def ground(self) -> Ground | None:
        """The ground of the first vehicle's image."""
        grounds = grounds_of((outcome.task for outcome in self.outcomes), self.settings, self.images)
        return next(iter(grounds.values()), self.settings.ground)


def watch(items: Sequence[Any], _: str) -> Iterable[Any]:
    """No progress is shown of what takes seconds."""
    return items


@contextmanager
def without_folder(folder: Path) -> Iterator[None]:
    """Errors say names of uploaded files as their sender knows them."""
    try:
        yield
    except InvalidInputError as error:
        where, value, fix = (
            part.replace(f"{folder}/", "") if isinstance(part, str) else part
            for part in (error.field, error.value, error.fix)
        )
        raise type(error)(str(where), value, str(fix)) from None


def solve(folder: Path, uploaded: Uploaded, requested: Requested, *, history: bool | None = None) -> SolvedUpload:
    """The vehicles of a photograph or a keypoint file.

    Args:
        folder: Where the files are.
        uploaded: Their names.
        requested: What is requested.
        history: Whether steps are kept; None for what is requested.

    Raises:
        InvalidInputError: A file or a value cannot be used.
    """
    with without_folder(folder), python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore", ContradictoryInputWarning)  # said below
        source, settings = requested.source(), requested.settings(history=history)
        if uploaded.camera is not None:
            source = replace(source, file=str(folder / uploaded.camera))
        seen = folder / uploaded.main if uploaded.of_image else folder / (uploaded.photograph or "")
        if uploaded.of_image or uploaded.photograph is not None:
            pixels, exif = read_photograph(seen)
            source = replace(source, image=pixels, exif=exif)
        tasks, said = (_from_image if uploaded.of_image else _from_file)(folder, uploaded, requested, source, settings)
        together = requested.shares_ground(of_image=uploaded.of_image)
        outcomes, images = solve_tasks(tasks, settings, together=together, watch=watch)
        return SolvedUpload(
            outcomes, images, settings, [*said, *_warnings(outcomes, images, source, uploaded)], source.image
        )


def _from_image(
    folder: Path, uploaded: Uploaded, requested: Requested, source: CameraSource, settings: RunSettings
) -> tuple[list[VehicleTask], list[str]]:
    path, pixels = folder / uploaded.main, source.image
    assert pixels is not None
    given, score = requested.boxes(), requested.number("min_score")
    file = None if uploaded.boxes is None or given else folder / uploaded.boxes
    search = None if given or file else pixels
    size = (pixels.shape[1], pixels.shape[0])
    found = boxes_of(path, given, file, search, size, score)
    how = KeypointRequest(settings.prior.category, None, requested.given_box_model)
    return image_tasks(path, source, found.cars, how, watch), []


def _from_file(
    folder: Path, uploaded: Uploaded, requested: Requested, source: CameraSource, settings: RunSettings
) -> tuple[list[VehicleTask], list[str]]:
    if requested.box:
        raise InvalidInputError("box", requested.box[0], "Leave it out: the boxes are in the keypoint file.")
    names = requested.names or None
    read = read_tasks(folder / uploaded.main, settings.prior.category, source, names, uploaded.photograph)
    return read.tasks, read.warnings


def _warnings(
    outcomes: Sequence[Outcome], images: Sequence[SolvedImage], source: CameraSource, uploaded: Uploaded
) -> list[str]:
    tasks = [outcome.task for outcome in outcomes]
    lines = input_warnings(tasks, detected=uploaded.of_image)
    lines += [] if lines or uploaded.of_image else fit_warnings(outcomes)
    estimated = next((i.result.camera for i in images if i.result.camera.focal_sigma), None)
    lines += [] if estimated is None else [assumed_focal_length(estimated, source.exif)]
    return lines + left_out_lines(outcomes)


def results_text(folder: Path, uploaded: Uploaded, requested: Requested) -> str:
    """The results file of an upload, as `fgrecon reconstruct --json` writes it, with what there is to warn of.

    Raises:
        InvalidInputError: A file or a value cannot be used, or that is so of every vehicle.
        FgreconError: Solving failed on every vehicle.
    """
    solved = solve(folder, uploaded, requested)
    if not check_any(Path(uploaded.main), solved.outcomes):
        reason = next((str(one.error) for one in solved.outcomes if one.error is not None), "no pose was found")
        raise FgreconError(f"No vehicle could be reconstructed: {reason}")
    photograph = Path(uploaded.main) if uploaded.of_image else None
    return document(
        Path(uploaded.main),
        solved.outcomes,
        solved.settings,
        solved.images,
        photograph,
        history=requested.keeps_history,
        warnings=solved.warnings,
    )


@lru_cache(maxsize=1)
def make_ready() -> bool:
    """Load what solves need, so that the first request does not wait for it."""
    from fgrecon.io.catalogue import load_prior
    from fgrecon.perception.boxes import detected_boxes
    from fgrecon.perception.keypoints.detect import shipped_cascade
    from fgrecon.simulation.sample import sample_street
    from fgrecon.solve.pipeline import reconstruct

    prior = load_prior("car14")
    street = sample_street(prior)
    detected_boxes(street.image)
    shipped_cascade()
    reconstruct(street.cars[0].observation, street.camera, prior=prior)
    return True
