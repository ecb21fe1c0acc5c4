"""The service behind `fgrecon calibrate`: a detector's calibration fitted on labelled drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from fgrecon.calibration.box_fit import check_whole_cars, detected_outlines, fit_boxes
from fgrecon.calibration.detector_fit import (
    FACTORS,
    FittedDetector,
    as_stated,
    check_labels,
    check_solved,
    fit_detector,
)
from fgrecon.calibration.labelled_drives import Advance, DriveRequest, ScoredDrives, score_drives
from fgrecon.core.detector_calibration import BoxSource, DetectorCalibration
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets import open_drive
from fgrecon.io.kitti_files import Drive

_EDGES = "Where the boxes' edges are"
_NUMBERS = "How far the network's errors go together, and its facings,"


@dataclass(frozen=True)
class CalibratedDetector:
    """A calibration and what it was fitted on."""

    calibration: DetectorCalibration  # what is written; its provenance has the warnings
    scored: ScoredDrives  # the drives, reconstructed as the network says its errors
    # what was fitted of the network, and how it holds without a drive; None where that could not be
    fitted: FittedDetector | None

    @property
    def numbers(self) -> dict[str, float]:
        """What was fitted, by name."""
        source = self.calibration.boxes
        boxes = {} if source is None else {f"boxes.{name}": value for name, value in asdict(source).items()}
        return ({} if self.fitted is None else self.calibration.numbers) | boxes


def calibrate_detector(
    request: DriveRequest,
    *,
    size_prior: str,
    warn: Callable[[str], None],
    advance: Advance,
    scored: Callable[[float, ScoredDrives], None] = lambda factor, done: None,  # noqa: ARG005
) -> CalibratedDetector:
    """Fit how far a keypoint network's errors go together, its facings, and where detected boxes' edges are.

    Args:
        request: The labelled drives; boxes are fitted where they are detected.
        size_prior: Name of the given fleet, for the provenance.
        warn: Called with everything that could not be fitted, or may be wrong.
        scored: Called with each factor of the covariances and the drives scored with it.

    Raises:
        InvalidInputError: Nothing could be fitted, or the drives cannot be used.
    """
    drives = [open_drive(folder) for folder in request.folders]
    check_labels(drives)
    kept: list[str] = []

    def warn_and_keep(line: str) -> None:
        kept.append(line)
        warn(line)

    def score(factor: float) -> ScoredDrives:
        done = score_drives(request, advance, keypoints=as_stated(factor))
        scored(factor, done)
        return done

    fits_boxes = request.detect and _has_whole_cars(drives, warn_and_keep)
    done = score(FACTORS[0])
    provenance: dict[str, Any] = {
        "drives": [drive.name for drive in drives],
        "networks": [{"file": network["file"], "drives": network["drives"]} for network in done.networks()],
        "ground": request.given.origin,
        "size_prior": size_prior,
        "boxes": request.boxes,
    }
    source = _fit_boxes(drives, done, provenance, warn_and_keep) if fits_boxes else None
    calibration, fitted = DetectorCalibration(provenance=provenance), None
    try:
        check_solved(done.boxes)
        fitted = fit_detector({FACTORS[0]: done.boxes} | {f: score(f).boxes for f in FACTORS[1:]}, provenance)
        calibration = fitted.calibration
    except InvalidInputError as error:
        if source is None:
            raise
        warn_and_keep(_left_out(_NUMBERS, error))
    for line in () if fitted is None else fitted.warnings:
        warn_and_keep(line)
    whole = {**calibration.provenance, "warnings": kept}
    return CalibratedDetector(replace(calibration, boxes=source, provenance=whole), done, fitted)


def _has_whole_cars(drives: list[Drive], warn_and_keep: Callable[[str], None]) -> bool:
    """Whether there are enough cars that are visible as a whole to fit boxes by."""
    try:
        check_whole_cars(drives)
    except InvalidInputError as error:
        warn_and_keep(_left_out(_EDGES, error))
        return False
    return True


def _fit_boxes(
    drives: list[Drive], done: ScoredDrives, provenance: dict[str, Any], warn_and_keep: Callable[[str], None]
) -> BoxSource | None:
    """Where the edges of detected boxes are (their count goes to the provenance); None where they are too few."""
    outlines = list(detected_outlines(drives, done.frames, done.request.given.scene.prior))
    try:
        source = fit_boxes(outlines)
    except InvalidInputError as error:
        warn_and_keep(_left_out(_EDGES, error))
        return None
    provenance["outlines"] = len(outlines)
    return source


def _left_out(what: str, error: InvalidInputError) -> str:
    return f"{what} could not be fitted: {error.value}. {error.fix}"
