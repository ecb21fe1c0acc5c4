"""Files of what was fitted to a keypoint detector: JSON, written by `fgrecon calibrate`."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path

from fgrecon.core.checks import as_instance, as_path
from fgrecon.core.detector_calibration import BoxSource, DetectorCalibration
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_text
from fgrecon.io.json_fields import Fields, read_json

__all__ = ["DETECTOR_FORMAT", "load_calibration", "save_calibration"]

DETECTOR_FORMAT = "fgrecon.detector/1"


def load_calibration(path: str | Path) -> DetectorCalibration:
    """Read a detector's calibration.

    Raises:
        InvalidInputError: The file cannot be read, is of another format, or a number is missing or out of range; names
            file and field.
    """
    file, where = as_path("calibration", path), f"{path}: "
    data = Fields(read_json(file), where)
    told = data.get("format", str)
    if told != DETECTOR_FORMAT:
        raise InvalidInputError(f"{where}format", told, f"Give a file of {DETECTOR_FORMAT}: `fgrecon calibrate`.")
    numbers = {name: float(data.numbers(name, ())) for name in DetectorCalibration().numbers}
    edges: dict[str, float] | None = None
    if "boxes" in data:
        told_of_boxes = Fields(data.get("boxes", dict), f"{where}boxes.")
        edges = {entry.name: float(told_of_boxes.numbers(entry.name, ())) for entry in fields(BoxSource)}
    try:
        source = None if edges is None else BoxSource(**edges)
        return DetectorCalibration(**numbers, provenance=data.get("provenance", dict), boxes=source)
    except InvalidInputError as error:
        raise InvalidInputError(f"{where}{error.field}", error.value, error.fix) from error


def save_calibration(calibration: DetectorCalibration, path: str | Path) -> Path:
    """Write a detector's calibration, whole or not at all.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    as_instance("calibration", calibration, DetectorCalibration)
    told = {"format": DETECTOR_FORMAT, **calibration.numbers, "provenance": dict(calibration.provenance)}
    if calibration.boxes is not None:
        told["boxes"] = asdict(calibration.boxes)
    return write_text(as_path("path", path), json.dumps(told, indent=1, allow_nan=False) + "\n")
